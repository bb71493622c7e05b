//! The map projection of coordinates, carried from a point cloud to a raster.
//!
//! **Input.** The keys of the GeoTIFF standard, which LAS files also contain, or text.
//!
//! **Output.** The same keys for a raster, and the unit of length that they name. The keys are not
//! interpreted further, so that a user-defined projection is kept unchanged.

use crate::Unit;

/// The coordinate reference system of a map, as keys of the GeoTIFF standard.
///
/// # References
/// OGC 19-008r4, *GeoTIFF standard*, 2019, section 7.
#[derive(Debug, Clone, PartialEq)]
pub struct GeoReference {
    /// Entries: key, tag that holds the value (0 for the entry itself), count, and value or index.
    pub(crate) keys: Vec<[u16; 4]>,
    /// Values of tag 34736.
    pub(crate) doubles: Vec<f64>,
    /// Values of tag 34737.
    pub(crate) text: Vec<u8>,
}

/// GeoTIFF keys.
const MODEL_TYPE: u16 = 1024;
const HEIGHT_UNITS: u16 = 4099;
pub(crate) const RASTER_TYPE: u16 = 1025;
const PROJECTED_CRS: u16 = 3072;
const PROJECTED_LINEAR_UNITS: u16 = 3076;
/// Value of [`MODEL_TYPE`] for coordinates in degrees.
const GEOGRAPHIC: u16 = 2;
/// TIFF tags that hold the values of keys.
pub(crate) const DOUBLES_TAG: u16 = 34736;
pub(crate) const TEXT_TAG: u16 = 34737;
/// EPSG codes of the metre, the international foot and the US survey foot.
const METRE: u16 = 9001;
const FEET: [u16; 2] = [9002, 9003];

impl GeoReference {
    /// Reads the three records of a LAS file: little-endian keys, doubles and text. None without a projected
    /// system.
    ///
    /// Entries that point outside their values are removed, so that a raster never gets invalid keys.
    pub(crate) fn from_keys(keys: &[u8], doubles: &[u8], text: &[u8]) -> Option<Self> {
        // The directory begins with four words: version, revision, minor revision, and the number of keys.
        let words: Vec<u16> = keys.chunks_exact(2).map(|b| u16::from_le_bytes([b[0], b[1]])).collect();
        let count = usize::from(*words.get(3)?);
        let doubles: Vec<f64> =
            doubles.chunks_exact(8).filter_map(|b| b.try_into().ok().map(f64::from_le_bytes)).collect();
        let keys: Vec<[u16; 4]> = (words.get(4..)?.chunks_exact(4).take(count))
            .map(|k| [k[0], k[1], k[2], k[3]])
            .filter(|&[key, tag, count, from]| {
                // Tag 0 means that the value is in the entry itself.
                let until = usize::from(from) + usize::from(count);
                key != 0
                    && match tag {
                        0 => true,
                        DOUBLES_TAG => until <= doubles.len(),
                        TEXT_TAG => until <= text.len(),
                        _ => false,
                    }
            })
            .collect();
        keys.iter().any(|k| k[0] == PROJECTED_CRS).then(|| Self { keys, doubles, text: text.to_vec() })
    }

    /// Reads the EPSG code of the projected system from well-known text; none if the text has no such code.
    pub(crate) fn from_wkt(wkt: &str) -> Option<Self> {
        // A compound system states the projected system first, and the vertical one after it.
        // Version 1 of well-known text spells it PROJCS, version 2 (ISO 19162) PROJCRS.
        let map = &wkt[wkt.find("PROJCS[").or_else(|| wkt.find("PROJCRS["))?..];
        let map = &map
            [..[map.find("VERT_CS["), map.find("VERTCRS[")].into_iter().flatten().min().unwrap_or(map.len())];
        let code = ["AUTHORITY[\"EPSG\",", "ID[\"EPSG\","].into_iter().find_map(|before| {
            // The last code is that of the system: the codes of its datum, ellipsoid and units are nested
            // before it.
            let code = &map[map.rfind(before)? + before.len()..];
            let digits: String =
                (code.chars().skip_while(|c| *c == '"')).take_while(char::is_ascii_digit).collect();
            digits.parse().ok()
        })?;
        let mut keys = vec![[MODEL_TYPE, 0, 1, 1], [PROJECTED_CRS, 0, 1, code]];
        // The unit of the projected system is the last one; earlier units belong to its angles.
        let length = map.rfind("UNIT[").and_then(|at| {
            let factor = map[at..].split(',').nth(1)?;
            factor.trim_end_matches(']').trim().parse::<f64>().ok()
        });
        if let Some(length) = length {
            let unit = [(METRE, 1.0), (FEET[0], 0.3048), (FEET[1], 1200.0 / 3937.0)]
                .into_iter()
                // The two feet differ by 6e-7 m, so the tolerance separates them.
                .find(|(_, metres)| (length - metres).abs() < 1e-8);
            keys.extend(unit.map(|(code, _)| [PROJECTED_LINEAR_UNITS, 0, 1, code]));
        }
        Some(Self { keys, doubles: Vec::new(), text: Vec::new() })
    }

    /// EPSG code of the projected system, if it has one.
    #[must_use]
    pub fn epsg(&self) -> Option<u16> {
        // 32767 marks a user-defined system.
        self.key(PROJECTED_CRS).filter(|&code| code != 0 && code != 32767)
    }

    /// Unit of the coordinates, if it is the metre or a foot.
    #[must_use]
    pub fn unit(&self) -> Option<Unit> {
        unit_of_code(self.key(PROJECTED_LINEAR_UNITS)?)
    }

    /// Unit of heights, if stated and the metre or a foot.
    pub(crate) fn height_unit(&self) -> Option<Unit> {
        unit_of_code(self.key(HEIGHT_UNITS)?)
    }

    fn key(&self, wanted: u16) -> Option<u16> {
        (self.keys.iter().find(|k| k[0] == wanted && k[1] == 0)).map(|k| k[3])
    }
}

/// The unit of an EPSG code.
fn unit_of_code(code: u16) -> Option<Unit> {
    match code {
        METRE => Some(Unit::Metre),
        code if FEET.contains(&code) => Some(Unit::Foot),
        _ => None,
    }
}

/// True if the keys of a raster state longitudes and latitudes instead of a projected map.
pub(crate) fn is_geographic(keys: &[u16]) -> bool {
    // The directory begins with four words that are no key.
    keys.chunks_exact(4).skip(1).any(|k| k[0] == MODEL_TYPE && k[3] == GEOGRAPHIC)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bytes(words: &[u16]) -> Vec<u8> {
        words.iter().flat_map(|w| w.to_le_bytes()).collect()
    }

    #[test]
    fn keys_are_kept_and_give_code_and_unit() {
        let keys = bytes(&[1, 1, 0, 3, 1024, 0, 1, 1, 3072, 0, 1, 2903, 3076, 0, 1, 9003]);
        let made = GeoReference::from_keys(&keys, &[], &[]).unwrap();
        assert_eq!((made.epsg(), made.unit()), (Some(2903), Some(Unit::Foot)));
        assert_eq!(made.keys.len(), 3);
        let own = bytes(&[1, 1, 0, 2, 3072, 0, 1, 32767, 3078, 34736, 1, 0]);
        let made = GeoReference::from_keys(&own, &43.0_f64.to_le_bytes(), &[]).unwrap();
        assert_eq!((made.epsg(), made.unit(), made.doubles.as_slice()), (None, None, &[43.0][..]));
    }

    #[test]
    fn keys_that_point_outside_their_values_are_removed() {
        let keys = bytes(&[1, 1, 0, 2, 3072, 0, 1, 32632, 3078, 34736, 4, 0]);
        let made = GeoReference::from_keys(&keys, &1.0_f64.to_le_bytes(), &[]).unwrap();
        assert_eq!(made.keys, [[3072, 0, 1, 32632]]);
        for cut in 0..12 {
            assert!(GeoReference::from_keys(&keys[..cut], &[], &[]).is_none(), "{cut}");
        }
    }

    #[test]
    fn well_known_text_gives_code_and_unit() {
        let wkt = "COMPD_CS[\"a\",PROJCS[\"b\",GEOGCS[\"c\",UNIT[\"degree\",0.0174,\
            AUTHORITY[\"EPSG\",\"9122\"]],\
                   AUTHORITY[\"EPSG\",\"4326\"]],UNIT[\"metre\",1,AUTHORITY[\"EPSG\",\"9001\"]],\
                   AUTHORITY[\"EPSG\",\"32632\"]],\
                   VERT_CS[\"d\",UNIT[\"foot\",0.3048],AUTHORITY[\"EPSG\",\"5703\"]]]";
        let made = GeoReference::from_wkt(wkt).unwrap();
        assert_eq!((made.epsg(), made.unit()), (Some(32632), Some(Unit::Metre)));
        assert!(
            GeoReference::from_wkt("").is_none()
                && GeoReference::from_wkt("PROJCS[\"x\",UNIT[\"m\",1]]").is_none()
        );
    }
}
