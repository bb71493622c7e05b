//! LAS and LAZ, the point clouds of airborne and terrestrial lidar.
//!
//! **Input.** Any point format, plain or compressed.
//!
//! **Output.** A [`Scan`] at the identity pose, with the class of each point if the file distinguishes
//! classes. Points marked as withheld are skipped.
//!
//! The decoder trusts the sizes that a file declares, so `limits` first checks that the file can hold them.
//!
//! **Limits.** Coordinates are in the unit and the map projection of the file. Heights are assumed to be in
//! the same unit.
//!
//! # References
//! ASPRS, *LAS Specification 1.4-R15*, 2019.

mod limits;
mod sequential;

use std::fs::File;
use std::io::{BufReader, Read};
use std::path::Path;

use las::Header;
use las::laz::is_laszip_vlr;
use laz::{DecompressionSelection, LasZipDecompressor};
use planish_core::Budget;
use planish_estimate::{Error, Result};
use planish_sense::Scan;

use self::sequential::Sequential;
use crate::GeoReference;
use crate::foreign::guarded;
use crate::numbers::NumberType;
use crate::points::{PointCollector, PointColumns};
use crate::source::{DATA_RATIO, open_file};

/// Approximate number of bytes of records that are read at once: amortises the call of the decoder and stays
/// in the cache.
const BATCH_BYTES: u64 = 1 << 21;

/// Reads points, and their classes if the file distinguishes classes.
///
/// # Errors
/// [`Io`](planish_estimate::ErrorKind::Io) when the file is missing or unreadable,
/// [`Input`](planish_estimate::ErrorKind::Input) when it is malformed or cut off.
pub fn read_las(path: &Path) -> Result<Scan> {
    read_las_and_map(path).map(|(scan, _)| scan)
}

/// [`read_las`], with the map projection of the header, if it states one.
pub(crate) fn read_las_and_map(path: &Path) -> Result<(Scan, Option<GeoReference>)> {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    scan_from(path, &name).map_err(|e| e.in_context(path.display()))
}

fn georeference(header: &Header) -> Option<GeoReference> {
    // Records 34735 to 34737 hold GeoTIFF keys, record 2112 well-known text.
    let record = |number: u16| {
        let mut all = header.all_vlrs();
        all.find(|vlr| vlr.user_id == PROJECTION && vlr.record_id == number).map(|vlr| vlr.data.as_slice())
    };
    // Keys are preferred to text, because a raster stores keys.
    let keys = record(34735).and_then(|keys| {
        GeoReference::from_keys(keys, record(34736).unwrap_or(&[]), record(34737).unwrap_or(&[]))
    });
    keys.or_else(|| record(2112).and_then(|wkt| GeoReference::from_wkt(&String::from_utf8_lossy(wkt))))
}

/// User ID of the records that hold a map projection.
const PROJECTION: &str = "LASF_Projection";

/// Reader of the point records of a file.
enum Records {
    Plain(BufReader<File>),
    /// Compressed point by point (LAZ up to version 1.3).
    Sequential(Box<Sequential<BufReader<File>>>),
    /// Compressed in layers (LAZ 1.4), of which only the used ones are decoded.
    Layered(Box<LasZipDecompressor<'static, BufReader<File>>>),
}

impl Records {
    /// Starts reading after the header.
    fn new(file: BufReader<File>, header: &Header) -> las::Result<Self> {
        if !header.point_format().is_compressed {
            return Ok(Self::Plain(file));
        }
        let description = header.laz_vlr()?;
        if description.items().iter().all(|item| item.version() < 3) {
            let one_chunk =
                header.vlrs().iter().any(|v| is_laszip_vlr(v) && v.data.starts_with(&limits::ONE_CHUNK));
            return Ok(Self::Sequential(Box::new(Sequential::new(file, &description, one_chunk)?)));
        }
        // Only the layers that are used. Skipped layers cost no time, and the decoder of the GPS time
        // recurses as often as a damaged layer requests, which overflows the stack (decision 0041).
        let wanted = DecompressionSelection::xy_returns_channel()
            .decompress_z()
            .decompress_classification()
            .decompress_flags();
        let decompressor = LasZipDecompressor::selective(file, description, wanted)?;
        Ok(Self::Layered(Box::new(decompressor)))
    }

    /// Reads whole records of `size` bytes.
    fn read(&mut self, bytes: &mut [u8], size: usize) -> laz::Result<()> {
        match self {
            Self::Plain(file) => Ok(file.read_exact(bytes)?),
            Self::Sequential(points) => {
                bytes.chunks_exact_mut(size).try_for_each(|record| points.read(record))
            }
            Self::Layered(decompressor) => Ok(decompressor.decompress_many(bytes)?),
        }
    }
}

fn scan_from(path: &Path, name: &str) -> Result<(Scan, Option<GeoReference>)> {
    let (file, length) = open_file(path)?;
    // Also for plain files, which stay far below: their records are longer than the points.
    let budget = length.map_or_else(Budget::of_process, |n| Budget::of_compressed(n, DATA_RATIO));
    let mut file = BufReader::new(file);
    limits::check(&mut file)?;
    let damaged = |what: &str| Error::input(format!("{what}: the file is damaged or not a LAS file"));
    let no_header = |e: las::Error| damaged("the header cannot be read").with_source(e);
    let header = guarded(|| Header::new(&mut file))?.map_err(no_header)?;
    let mut records = guarded(|| Records::new(file, &header))?.map_err(no_header)?;
    let promised = header.number_of_points();
    let format = *header.point_format();
    let record = u64::from(format.len());
    let axes = header.transforms();
    let at_once = (BATCH_BYTES / record).max(1);
    let mut bytes = Vec::new();
    // Nothing is reserved, because a compressed file may promise a hundred times its own size.
    let mut collector = PointCollector::new(PointColumns::positions_only(), 0, &budget);
    let mut classes = Vec::new();
    let mut point = 0;
    while point < promised {
        // At most about `BATCH_BYTES`, so the conversion is exact.
        bytes.resize((at_once.min(promised - point) * record) as usize, 0);
        guarded(|| records.read(&mut bytes, usize::from(format.len())))?.map_err(|e| {
            damaged(&format!("point {point} or one soon after cannot be read")).with_source(e)
        })?;
        for bytes in bytes.chunks_exact(usize::from(format.len())) {
            // Coordinates are the first three fields of every point format.
            let integer = |at: usize| NumberType::I32.decode::<false>(&bytes[at..at + 4]) as i32;
            if !is_withheld(bytes, format.is_extended) {
                let before = collector.len();
                let place = [axes.x.direct(integer(0)), axes.y.direct(integer(4)), axes.z.direct(integer(8))];
                collector.push(&place, format_args!("point {point}"))?;
                // Classes must match the kept points.
                if collector.len() > before {
                    classes.push(class(bytes, format.is_extended));
                }
            }
            point += 1;
        }
    }
    let (mut scan, _) = collector.finish(name);
    // If nothing was classified, the classes carry no information and must not select the ground.
    if classes.iter().any(|c| *c > UNCLASSIFIED) {
        scan.classes = Some(classes);
    }
    Ok((scan, georeference(&header)))
}

/// Classes 0 (never classified) and 1 (unclassified) do not count.
const UNCLASSIFIED: u8 = 1;

/// Class of a record: byte 16 of formats 6 to 10, five bits of byte 15 of formats 0 to 5.
fn class(record: &[u8], extended: bool) -> u8 {
    match extended {
        true => record[16],
        false => record[15] & 0b1_1111,
    }
}

/// True if a record is marked as withheld (deleted).
fn is_withheld(record: &[u8], extended: bool) -> bool {
    // Byte 15 holds the class and flags in formats 0 to 5, and only flags in formats 6 to 10.
    record[15] & if extended { 0b100 } else { 0b1000_0000 } != 0
}

#[cfg(test)]
mod tests {
    use super::*;
    use las::point::{Classification, Format};
    use las::{Builder, Point, Transform, Vector, Writer};
    use std::fs;
    use std::path::PathBuf;

    /// A hundred points near (6e5, 4e6), one of them withheld; every third one ground.
    fn file(folder: &Path, name: &str, classified: bool) -> PathBuf {
        let path = folder.join(name);
        let mut builder = Builder::from((1, 4));
        builder.point_format = Format::new(6).unwrap();
        let axis = |offset| Transform { scale: 0.01, offset };
        builder.transforms = Vector { x: axis(600_000.0), y: axis(4_000_000.0), z: axis(0.0) };
        let mut writer = Writer::from_path(&path, builder.into_header().unwrap()).unwrap();
        for i in 0..100 {
            let class = if i % 3 == 0 { Classification::Ground } else { Classification::Unclassified };
            let point = Point {
                x: 600_000.0 + 0.25 * f64::from(i),
                y: 4_000_000.5,
                z: 0.01 * f64::from(i),
                classification: if classified { class } else { Classification::Unclassified },
                is_withheld: i == 50,
                gps_time: Some(f64::from(i * i)),
                ..Point::default()
            };
            writer.write_point(point).unwrap();
        }
        writer.close().unwrap();
        path
    }

    #[test]
    fn plain_and_compressed_files_give_the_same_points_and_classes() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["a.las", "a.laz"] {
            let scan = read_las(&file(folder.path(), name, true)).unwrap();
            assert_eq!(scan.points.len(), 99, "{name}");
            for (p, expected) in scan.points[98].to_array().iter().zip([600_024.75, 4_000_000.5, 0.99]) {
                assert!((p - expected).abs() < 1e-9, "{name}: {p}");
            }
            assert_eq!(scan.classes.unwrap().iter().filter(|&&c| c == 2).count(), 34);
        }
        let scan = read_las(&file(folder.path(), "b.las", false)).unwrap();
        assert!(scan.classes.is_none(), "a single class carries no information");
    }

    #[test]
    fn errors_of_damaged_files_name_the_place() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["a.las", "a.laz"] {
            let path = file(folder.path(), name, true);
            let bytes = fs::read(&path).unwrap();
            let message = |bytes: &[u8]| {
                fs::write(&path, bytes).unwrap();
                read_las(&path).map(|scan| scan.points.len()).unwrap_err().to_string()
            };
            assert!(message(&bytes[..bytes.len() * 2 / 3]).contains(name));
            assert!(message(&bytes[..100]).contains("the header cannot be read"));
            assert!(message(b"LASF but no more").contains("the header cannot be read"));
            // The counts of points in the header of version 1.4, and of those before.
            let mut bomb = bytes.clone();
            bomb[107..111].copy_from_slice(&1_000_000_000_u32.to_le_bytes());
            bomb[247..255].copy_from_slice(&1_000_000_000_u64.to_le_bytes());
            assert!(message(&bomb).contains(name));
        }
    }

    /// Writes a spiral of points. Their times come from several lasers, repeat, jump and go back.
    fn spiral(path: &Path, format: u8, count: u32) {
        let mut builder = Builder::from((1, if format < 6 { 2 } else { 4 }));
        builder.point_format = Format::new(format).unwrap();
        let format = builder.point_format;
        let mut writer = Writer::from_path(path, builder.into_header().unwrap()).unwrap();
        let mut state = 1_u32;
        for i in 0..count {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            let laser = f64::from(state >> 30);
            let leap = [0.0, 1.0, 1.0, 20.0, 900.0, -3.0, -70.0, 1e5][(state >> 20) as usize % 8];
            let time = 1e6 * laser + f64::from(i / 7) + 1e-3 * leap * f64::from(state >> 25);
            let point = Point {
                x: 0.01 * f64::from(i) * (0.1 * f64::from(i)).cos(),
                y: 0.01 * f64::from(i) * (0.1 * f64::from(i)).sin(),
                z: 0.001 * f64::from(i % 90),
                gps_time: format.has_gps_time.then_some(time),
                color: format.has_color.then(|| las::Color::new(1, (state >> 16) as u16, 3)),
                ..Point::default()
            };
            writer.write_point(point).unwrap();
        }
        writer.close().unwrap();
    }

    #[test]
    fn all_point_formats_read_the_same_with_and_without_compression() {
        let folder = tempfile::tempdir().unwrap();
        for (format, count) in [(0, 500), (1, 110_000), (2, 500), (3, 9000), (6, 9000), (7, 9000)] {
            let [plain, packed] = ["a.las", "a.laz"].map(|name| {
                let path = folder.path().join(name);
                spiral(&path, format, count);
                read_las(&path).unwrap().points
            });
            assert_eq!(plain.len(), count as usize);
            assert!(plain == packed, "format {format}");
        }
    }

    #[test]
    fn damaged_times_do_not_cause_endless_recursion() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.laz");
        spiral(&path, 1, 3000);
        let complete = fs::read(&path).unwrap();
        let start = u32::from_le_bytes(complete[96..100].try_into().unwrap()) as usize;
        for k in 0..200 {
            // Constant bytes drive the decoder to the same symbol again and again.
            let mut bytes = complete.clone();
            let at = start + 40 + 61 * k % (complete.len() - start - 200);
            bytes[at..complete.len() - 100].fill([0xff, 0, 0x7f][k % 3]);
            fs::write(&path, &bytes).unwrap();
            let _ = read_las(&path);
        }
    }

    #[test]
    fn a_damaged_unused_layer_is_not_decoded() {
        let folder = tempfile::tempdir().unwrap();
        let path = file(folder.path(), "a.laz", true);
        let complete = read_las(&path).unwrap();
        let mut bytes = fs::read(&path).unwrap();
        let number = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()) as usize;
        // The first point and a count precede the sizes of nine layers; the last is that of the times.
        let sizes = number(96) + 8 + 30 + 4;
        let layers: Vec<usize> = (0..9).map(|k| number(sizes + 4 * k)).collect();
        let times = sizes + 36 + layers[..8].iter().sum::<usize>();
        assert!(layers[8] > 20);
        bytes[times..times + layers[8]].fill(0xff);
        fs::write(&path, &bytes).unwrap();
        let read = read_las(&path).unwrap();
        assert!(read.points == complete.points && read.classes == complete.classes);
    }

    /// Damages every number that makes the decoder allocate memory, in files of some kilobytes.
    #[test]
    fn impossible_sizes_are_rejected_before_memory_is_allocated() {
        let folder = tempfile::tempdir().unwrap();
        let plain = fs::read(file(folder.path(), "a.las", true)).unwrap();
        let packed = fs::read(file(folder.path(), "a.laz", true)).unwrap();
        let number =
            |bytes: &[u8], at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()) as usize;
        let points = number(&packed, 96);
        let table = number(&packed, points);
        // The description of the compression: its first item's size stands 38 bytes after its head.
        let head = packed.windows(14).position(|w| w == b"laszip encoded").unwrap() - 2;
        for (name, bytes, at, written, words) in [
            ("a.las", &plain, 235, &u64::to_le_bytes(400)[..], "extended record"),
            ("a.laz", &packed, 235, &u64::to_le_bytes(400)[..], "extended record"),
            ("a.laz", &packed, table + 4, &[0xff; 4], "a table of 4294967295 chunks"),
            ("a.laz", &packed, points, &[0xff; 8], "the table of the chunks"),
            ("a.laz", &packed, points + 8 + 30 + 4, &[0xff; 4], "chunk 0 declares"),
            ("a.laz", &packed, head + 54 + 36, &u16::to_le_bytes(31), "items of a point: expected"),
            ("a.laz", &packed, 105, &u16::to_le_bytes(65_000), "at most 4096 bytes"),
            ("a.laz", &packed, 247, &u64::to_le_bytes(1 << 40), "over 100 times their size"),
        ] {
            let mut bomb = bytes.clone();
            bomb[at..at + written.len()].copy_from_slice(written);
            if at == 235 {
                // One extended record, whose length is the largest there is.
                bomb[243..247].copy_from_slice(&1_u32.to_le_bytes());
                bomb[420..428].copy_from_slice(&(u64::MAX >> 1).to_le_bytes());
            }
            if at == 247 {
                bomb[107..111].fill(0);
            }
            let path = folder.path().join("bomb").with_extension(Path::new(name).extension().unwrap());
            fs::write(&path, bomb).unwrap();
            let e = read_las(&path).map(|scan| scan.points.len()).unwrap_err();
            assert_eq!(e.kind(), planish_estimate::ErrorKind::Input, "{e}");
            assert!(e.to_string().contains(words), "{words}: {e}");
        }
    }
}
