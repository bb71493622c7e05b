//! LAS and LAZ, the point clouds of airborne and terrestrial lidar.
//!
//! **Input.** Any point format, plain or compressed.
//!
//! **Output.** A [`Scan`] at the identity pose, with the class of each point if the file distinguishes any.
//! Points marked as withheld are not read.
//!
//! The decoder trusts the sizes that a file declares, so `limits` first checks that the file can hold them.
//!
//! **Limits.** Coordinates are in the unit and the map projection of the file. Heights are assumed to be in
//! the same unit.

mod limits;
mod sequential;

use std::fs::File;
use std::io::{BufReader, Read};
use std::path::Path;

use las::Header;
use las::laz::is_laszip_vlr;
use laz::{DecompressionSelection, LasZipDecompressor};
use planish_estimate::{Error, Result};
use planish_sense::Scan;

use self::sequential::Sequential;
use crate::GeoReference;
use crate::foreign::guarded;
use crate::numbers::NumberType;
use crate::points::{PointCollector, PointColumns};
use crate::source::open_file;

/// Bytes of records that are read at once, about.
const BATCH_BYTES: u64 = 1 << 21;

/// Reads points, and their classes where the file holds any.
///
/// # Errors
/// [`Io`](planish_estimate::ErrorKind::Io) when the file is missing or unreadable,
/// [`Input`](planish_estimate::ErrorKind::Input) when it is malformed or cut off.
pub fn read_las(path: &Path) -> Result<Scan> {
    read_las_and_map(path).map(|(scan, _)| scan)
}

/// [`read_las`], with the map that the header names, where it names any.
pub(crate) fn read_las_and_map(path: &Path) -> Result<(Scan, Option<GeoReference>)> {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    scan_from(path, &name).map_err(|e| e.in_context(path.display()))
}

fn georeference(header: &Header) -> Option<GeoReference> {
    let record = |number: u16| {
        let mut all = header.all_vlrs();
        all.find(|vlr| vlr.user_id == PROJECTION && vlr.record_id == number).map(|vlr| vlr.data.as_slice())
    };
    let keys = record(34735).and_then(|keys| {
        GeoReference::from_keys(keys, record(34736).unwrap_or(&[]), record(34737).unwrap_or(&[]))
    });
    keys.or_else(|| record(2112).and_then(|wkt| GeoReference::from_wkt(&String::from_utf8_lossy(wkt))))
}

/// Who defines the records that hold a map.
const PROJECTION: &str = "LASF_Projection";

/// The records of a file, one after the other.
enum Records {
    Plain(BufReader<File>),
    /// One after the other.
    Sequential(Box<Sequential<BufReader<File>>>),
    /// In layers, of which only some are read.
    Layered(Box<LasZipDecompressor<'static, BufReader<File>>>),
}

impl Records {
    /// The records behind a header.
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
        // No more than is looked at. Layers that are left out cost no time, and that of the time of flight
        // breaks the decoder: it calls itself as often as a damaged layer says.
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
    let mut file = BufReader::new(open_file(path)?.0);
    limits::check(&mut file)?;
    let damaged = |what: &str| Error::input(format!("{what}: the file is damaged or no LAS file"));
    let no_header = |e: las::Error| damaged("the header cannot be read").with_source(e);
    let header = guarded(|| Header::new(&mut file))?.map_err(no_header)?;
    let mut records = guarded(|| Records::new(file, &header))?.map_err(no_header)?;
    let promised = header.number_of_points();
    let format = *header.point_format();
    let record = u64::from(format.len());
    let axes = header.transforms();
    let at_once = (BATCH_BYTES / record).max(1);
    let mut bytes = Vec::new();
    let mut collector = PointCollector::new(PointColumns::positions_only(), 0);
    let mut classes = Vec::new();
    let mut point = 0;
    while point < promised {
        // Both are small.
        bytes.resize((at_once.min(promised - point) * record) as usize, 0);
        guarded(|| records.read(&mut bytes, usize::from(format.len())))?.map_err(|e| {
            damaged(&format!("point {point} or one of the next cannot be read")).with_source(e)
        })?;
        for bytes in bytes.chunks_exact(usize::from(format.len())) {
            let whole = |at: usize| NumberType::I32.decode::<false>(&bytes[at..at + 4]) as i32;
            if !is_withheld(bytes, format.is_extended) {
                let before = collector.len();
                let place = [axes.x.direct(whole(0)), axes.y.direct(whole(4)), axes.z.direct(whole(8))];
                collector.push(&place, format_args!("point {point}"))?;
                // A point that was dropped has no class.
                if collector.len() > before {
                    classes.push(class(bytes, format.is_extended));
                }
            }
            point += 1;
        }
    }
    let (mut scan, _) = collector.finish(name);
    // Never classified, or all alike: that says nothing.
    if classes.iter().any(|c| *c > UNCLASSIFIED) {
        scan.classes = Some(classes);
    }
    Ok((scan, georeference(&header)))
}

/// Class 0 was never classified, 1 is unclassified.
const UNCLASSIFIED: u8 = 1;

/// What a record lies on.
fn class(record: &[u8], extended: bool) -> u8 {
    match extended {
        true => record[16],
        false => record[15] & 0b1_1111,
    }
}

/// Whether a record carries the mark that it should not be used.
fn is_withheld(record: &[u8], extended: bool) -> bool {
    // Byte 15 holds class and marks in formats 0 to 5, the marks alone in formats 6 to 10.
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
            for (p, expected) in scan.points[98].iter().zip([600_024.75, 4_000_000.5, 0.99]) {
                assert!((p - expected).abs() < 1e-9, "{name}: {p}");
            }
            assert_eq!(scan.classes.unwrap().iter().filter(|&&c| c == 2).count(), 34);
        }
        let scan = read_las(&file(folder.path(), "b.las", false)).unwrap();
        assert!(scan.classes.is_none(), "one class for all says nothing");
    }

    #[test]
    fn damaged_files_are_errors_that_say_where() {
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

    /// A spiral of points in a point format, whose times come from three lasers, stand still, leap and go
    /// back.
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
    fn every_point_format_reads_the_same_compressed_across_chunks_and_series_of_times() {
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
    fn damaged_times_are_an_error_and_no_endless_call() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.laz");
        spiral(&path, 1, 3000);
        let whole = fs::read(&path).unwrap();
        let start = u32::from_le_bytes(whole[96..100].try_into().unwrap()) as usize;
        for k in 0..200 {
            // Ever the same bytes drive a decoder to ever the same symbol.
            let mut bytes = whole.clone();
            let at = start + 40 + 61 * k % (whole.len() - start - 200);
            bytes[at..whole.len() - 100].fill([0xff, 0, 0x7f][k % 3]);
            fs::write(&path, &bytes).unwrap();
            let _ = read_las(&path);
        }
    }

    #[test]
    fn a_damaged_layer_that_nobody_needs_is_not_decoded() {
        let folder = tempfile::tempdir().unwrap();
        let path = file(folder.path(), "a.laz", true);
        let whole = read_las(&path).unwrap();
        let mut bytes = fs::read(&path).unwrap();
        let number = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()) as usize;
        // Behind the first point and a count stand the sizes of nine layers; that of times is the last.
        let sizes = number(96) + 8 + 30 + 4;
        let layers: Vec<usize> = (0..9).map(|k| number(sizes + 4 * k)).collect();
        let times = sizes + 36 + layers[..8].iter().sum::<usize>();
        assert!(layers[8] > 20);
        bytes[times..times + layers[8]].fill(0xff);
        fs::write(&path, &bytes).unwrap();
        let read = read_las(&path).unwrap();
        assert!(read.points == whole.points && read.classes == whole.classes);
    }

    /// Every number that decoders take memory for, in turn: none of these files is larger than some
    /// kilobytes.
    #[test]
    fn sizes_that_a_file_cannot_hold_are_refused_before_they_take_memory() {
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
            ("a.laz", &packed, points + 8 + 30 + 4, &[0xff; 4], "chunk 0 promises"),
            ("a.laz", &packed, head + 54 + 36, &u16::to_le_bytes(31), "items of a point take"),
            ("a.laz", &packed, 105, &u16::to_le_bytes(65_000), "at most 4096 bytes"),
            ("a.laz", &packed, 247, &u64::to_le_bytes(1 << 40), "would fill the memory"),
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
