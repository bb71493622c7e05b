use super::*;
use planish_estimate::ErrorKind;
use tiff::decoder::{Decoder, DecodingResult};

fn grid() -> HeightGrid {
    HeightGrid {
        corner: [600_000.25, 4_000_000.75],
        cell: 0.5,
        columns: 3,
        rows: 2,
        values: vec![[1.0, 0.1], [2.0, 0.2], [NODATA; 2], [4.0, 0.4], [5.5, 0.5], [6.0, 0.6]],
        unit: Unit::Metre,
        georeference: GeoReference::from_wkt("PROJCS[\"x\",UNIT[\"metre\",1],AUTHORITY[\"EPSG\",\"32632\"]]"),
    }
}

#[test]
fn written_grids_read_back_unchanged() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.tif");
    write_geotiff(&path, &grid()).unwrap();
    let mut decoder = Decoder::new(std::fs::File::open(&path).unwrap()).unwrap();
    assert_eq!(decoder.dimensions().unwrap(), (3, 2));
    let scale = decoder.get_tag_f64_vec(Tag::ModelPixelScaleTag).unwrap();
    let tie = decoder.get_tag_f64_vec(Tag::ModelTiepointTag).unwrap();
    assert_eq!(scale, [0.5, 0.5, 0.0]);
    // Coordinates keep double precision.
    assert_eq!(tie, [0.0, 0.0, 0.0, 600_000.25, 4_000_000.75, 0.0]);
    let keys = decoder.get_tag_u16_vec(Tag::GeoKeyDirectoryTag).unwrap();
    assert_eq!(keys, [1, 1, 0, 4, 1024, 0, 1, 1, 1025, 0, 1, 1, 3072, 0, 1, 32632, 3076, 0, 1, 9001]);
    assert_eq!(decoder.get_tag_ascii_string(Tag::GdalNodata).unwrap(), "-9999");
    let names = decoder.get_tag_ascii_string(GDAL_METADATA).unwrap();
    assert!(names.contains(">height<") && names.contains(">sigma of the height<"), "{names}");
    let DecodingResult::F32(samples) = decoder.read_image().unwrap() else {
        panic!("expected single precision");
    };
    let expected: Vec<f32> = grid().values.iter().flatten().copied().collect();
    assert_eq!(samples, expected);
}

#[test]
fn the_same_grid_gives_the_same_bytes() {
    assert_eq!(encoded(&grid()).unwrap(), encoded(&grid()).unwrap());
}

#[test]
fn a_grid_with_a_wrong_number_of_cells_is_rejected() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.tif");
    for (columns, rows) in [(0, 0), (2, 2)] {
        let bad = HeightGrid { columns, rows, ..grid() };
        assert_eq!(write_geotiff(&path, &bad).unwrap_err().kind(), ErrorKind::Input);
        assert!(!path.exists());
    }
}

fn written(grid: &HeightGrid) -> (tempfile::TempDir, std::path::PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.tif");
    write_geotiff(&path, grid).unwrap();
    (folder, path)
}

#[test]
fn a_written_grid_is_read_as_points_of_the_map() {
    let (_folder, path) = written(&grid());
    assert!(is_height_map(&path));
    let found = read_geotiff(&path).unwrap();
    assert_eq!((found.unit, found.georeference), (Some(Unit::Metre), grid().georeference));
    let scan = found.scan;
    // The third cell is empty; the fourth one begins the second row.
    assert_eq!((scan.points.len(), scan.dropped_not_finite), (5, 1));
    assert_eq!(scan.points[2], [600_000.5, 4_000_000.0, f64::from(4.0_f32)].into());
    let covariance = &scan.covariance.unwrap()[2];
    let sigma = f64::from(0.4_f32);
    assert_eq!(covariance.zz, sigma * sigma);
    assert!(covariance.xx > 0.0 && covariance.xx < 0.01 * covariance.zz);
    let cells = scan.grid.unwrap();
    assert_eq!((cells.columns, cells.rows, cells.cells[3]), (3, 2, 2));
}

#[test]
fn a_cell_without_sigma_is_named() {
    for sigma in [-0.2, 0.0, f32::NAN] {
        let mut wrong = grid();
        wrong.values[4][1] = sigma;
        let (_folder, path) = written(&wrong);
        let error = read_geotiff(&path).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::Input);
        assert!(error.to_string().contains("column 1, row 1: expected σ > 0"), "{error}");
    }
}

/// A TIFF image of one band of 16 bits with the given tags.
fn image(
    tags: impl FnOnce(
        &mut tiff::encoder::DirectoryEncoder<'_, &mut Cursor<Vec<u8>>, tiff::encoder::TiffKindStandard>,
    ),
) -> (tempfile::TempDir, std::path::PathBuf) {
    let mut file = Cursor::new(Vec::new());
    let mut encoder = TiffEncoder::new(&mut file).unwrap();
    let mut image = encoder.new_image::<tiff::encoder::colortype::Gray16>(2, 2).unwrap();
    tags(image.encoder());
    image.write_data(&[10, 20, 30, 65535]).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.tif");
    std::fs::write(&path, file.into_inner()).unwrap();
    (folder, path)
}

#[test]
fn one_band_of_another_program_has_heights_without_sigma() {
    let (_folder, path) = image(|tags| {
        tags.write_tag(Tag::ModelPixelScaleTag, &[2.0, 3.0, 0.0][..]).unwrap();
        tags.write_tag(Tag::ModelTiepointTag, &[0.0, 0.0, 0.0, 100.0, 200.0, 0.0][..]).unwrap();
        tags.write_tag(Tag::GdalNodata, "65535").unwrap();
        // Pixels are points; heights are in metres as the map is.
        let keys = [1_u16, 1, 0, 4, 1025, 0, 1, 2, 3072, 0, 1, 32632, 3076, 0, 1, 9001, 4099, 0, 1, 9001];
        tags.write_tag(Tag::GeoKeyDirectoryTag, &keys[..]).unwrap();
    });
    let found = read_geotiff(&path).unwrap();
    let points: Vec<[f64; 3]> = found.scan.points.iter().map(|p| p.to_array()).collect();
    assert_eq!(points, [[100.0, 200.0, 10.0], [102.0, 200.0, 20.0], [100.0, 197.0, 30.0]]);
    assert!(found.scan.covariance.is_none() && found.scan.sigma.is_none());
    assert_eq!(found.unit, Some(Unit::Metre));
}

#[test]
fn maps_that_would_be_misread_are_refused() {
    let tied = |scale: [f64; 3], keys: &[u16]| {
        let (_folder, path) = image(|tags| {
            tags.write_tag(Tag::ModelPixelScaleTag, &scale[..]).unwrap();
            tags.write_tag(Tag::ModelTiepointTag, &[0.0, 0.0, 0.0, 1.0, 2.0, 0.0][..]).unwrap();
            tags.write_tag(Tag::GeoKeyDirectoryTag, keys).unwrap();
        });
        read_geotiff(&path).unwrap_err().to_string()
    };
    assert!(tied([1.0, -1.0, 0.0], &[1, 1, 0, 0]).contains("sides > 0"));
    assert!(tied([1.0, 1.0, 0.0], &[1, 1, 0, 1, 1024, 0, 1, 2]).contains("in degrees"));
    let feet = [1, 1, 0, 3, 3072, 0, 1, 32632, 3076, 0, 1, 9001, 4099, 0, 1, 9002];
    assert!(tied([1.0, 1.0, 0.0], &feet).contains("found heights in ft"));
    let (_folder, path) = image(|tags| {
        tags.write_tag(Tag::Unknown(34264), &[1.0; 16][..]).unwrap();
    });
    assert!(is_height_map(&path) && read_geotiff(&path).unwrap_err().to_string().contains("rotate the map"));
    let (_folder, path) = image(|_| {});
    assert!(!is_height_map(&path));
}
