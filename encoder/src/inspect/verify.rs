//! Looking for what is wrong with a scene file, all of it, not the first alone.

use std::collections::VecDeque;

use rayon::prelude::*;

use crate::{Error, Level, PcastFile};

/// What [`verify`] finds.
#[derive(Debug)]
pub struct Report {
    /// Tiles of all levels.
    pub tiles: u64,
    /// What is wrong, a line a broken tile.
    pub faults: Vec<Error>,
}

/// How much of a file to check.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Depth {
    /// Checksums alone.
    Checksums,
    /// Every byte of every tile, too.
    Tiles,
    /// And that the exposed voxels are just those with an exposed face, which neighbour tiles tell.
    Exposure,
}

/// Checks the tiles of a file whose header and directory were found right.
pub fn verify(file: &PcastFile, depth: Depth) -> Report {
    let n_tiles = file.entries().len() as u64;
    if depth == Depth::Exposure {
        return Report { tiles: n_tiles, faults: exposure(file) };
    }
    let tiles = file.grids().iter().enumerate().flat_map(|(k, grid)| {
        let [across, along] = grid.tiles;
        (0..along).flat_map(move |tz| (0..across).map(move |tx| (k, tx, tz)))
    });
    let check = |(tile, (k, tx, tz))| {
        let checked = match depth {
            Depth::Checksums => file.stored(k, tx, tz).map(drop),
            _ => file.check_tile(k, tx, tz),
        };
        checked.err().map(|fault| (tile, fault))
    };
    // Each thread takes the next tile: systems read ahead of who goes from front to back.
    let mut faults: Vec<(usize, Error)> = tiles.enumerate().par_bridge().filter_map(check).collect();
    faults.sort_unstable_by_key(|fault| fault.0);
    Report { tiles: n_tiles, faults: faults.into_iter().map(|fault| fault.1).collect() }
}

/// What is wrong with tiles and their exposed voxels. Three rows of tiles are in memory.
fn exposure(file: &PcastFile) -> Vec<Error> {
    let mut faults = Vec::new();
    for (k, grid) in file.grids().iter().enumerate() {
        // The row before the one that is looked at, itself, and the next; None for what is broken.
        let mut rows: VecDeque<(u32, Vec<Option<Level>>)> = VecDeque::new();
        let check = |rows: &VecDeque<(u32, Vec<Option<Level>>)>, tz: u32| {
            file.check_exposure_of_row(k, tz, |tx, tz| {
                let (_, row) = rows.iter().find(|r| r.0 == tz)?;
                row[tx as usize].as_ref()
            })
        };
        for tz in 0..grid.tiles[1] {
            let tiles: Vec<Result<Level, Error>> =
                (0..grid.tiles[0]).into_par_iter().map(|tx| file.tile(k, tx, tz)).collect();
            let tiles = tiles.into_iter().map(|tile| tile.map_err(|fault| faults.push(fault)).ok());
            rows.push_back((tz, tiles.collect()));
            if tz > 0 {
                faults.extend(check(&rows, tz - 1));
            }
            if rows.len() > 2 {
                rows.pop_front();
            }
        }
        faults.extend(check(&rows, grid.tiles[1] - 1));
    }
    faults
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::format::forms::Lists;
    use crate::format::write::write_scene_to;
    use crate::format::{Header, Section};
    use crate::{BuildOptions, ColorMode, Columns, build, testing};

    const DEPTHS: [Depth; 3] = [Depth::Checksums, Depth::Tiles, Depth::Exposure];

    fn scene(color: ColorMode) -> Vec<u8> {
        let columns = Columns::from_fn(600, 9, 530, |x, y, z| y < 4 + (x * 7 + z * 3) % 5);
        let opts = BuildOptions { color: Some(color), ..Default::default() };
        let mut bytes = std::io::Cursor::new(Vec::new());
        let scene = build(testing::input(columns, true), &opts).unwrap();
        write_scene_to(&scene, &mut bytes, "a.pcast".as_ref()).unwrap();
        bytes.into_inner()
    }

    #[test]
    fn verify_finds_nothing_wrong_with_a_good_file() {
        for color in [ColorMode::None, ColorMode::Voxel] {
            let file = PcastFile::from_bytes("a.pcast", scene(color)).unwrap();
            for depth in DEPTHS {
                let report = verify(&file, depth);
                assert!(report.faults.is_empty(), "{report:?}");
                assert_eq!(report.tiles, 9 + 4 + 9);
            }
        }
    }

    #[test]
    fn verify_names_every_broken_tile_and_the_rest_stays_readable() {
        for color in [ColorMode::None, ColorMode::Voxel] {
            let mut bytes = scene(color);
            let good = PcastFile::from_bytes("a.pcast", bytes.clone()).unwrap();
            for tile in [1, 6, 10] {
                let entry = good.entries()[tile];
                bytes[entry.offset as usize + entry.len as usize / 2] ^= 4;
            }
            let file = PcastFile::from_bytes("a.pcast", bytes).unwrap();
            for depth in DEPTHS {
                let faults: Vec<String> = verify(&file, depth).faults.iter().map(Error::to_string).collect();
                assert_eq!(faults.len(), 3, "{faults:?}");
                for (fault, place) in faults.iter().zip(["(1, 0) of level 0", "(0, 2) of level 0", "(1, 0) of level 1"])
                {
                    assert!(fault.contains(place) && fault.contains("does not match its checksum"), "{fault}");
                }
            }
            assert!(file.read_scene().is_err());
            let (found, faults) = file.read_scene_without_broken().unwrap();
            assert_eq!(faults.len(), 3);
            let expected = good.read_scene().unwrap();
            let (found, expected) = (&found.levels[0].solid, &expected.levels[0].solid);
            for (x, z) in [(0, 0), (255, 529), (512, 0), (599, 300)] {
                let broken = (x / 256, z / 256) == (1, 0) || (x / 256, z / 256) == (0, 2);
                assert_eq!(found.column(x, z), if broken { &[] } else { expected.column(x, z) });
            }
            assert!(file.query(0, 0, 0).unwrap().solid);
            assert!(file.query(300, 0, 0).is_err());
        }
    }

    #[test]
    fn verify_finds_exposure_that_a_faulty_program_wrote() {
        let columns = Columns::from_fn(300, 9, 9, |_, _, _| true);
        let good = build(testing::input(columns, true), &BuildOptions::default()).unwrap();
        let mut bad = good.clone();
        // Of tile (1, 0), a voxel that is hidden is shown.
        let exposed = bad.levels[0].exposed.take().unwrap();
        bad.levels[0].exposed = Some(Columns::from_rows(300, 9, 9, |z, out| {
            for x in 0..300 {
                match (x, z) {
                    (280, 4) => [0, 3, 8].map(|y| out.push_run(crate::Run::new(y, y))).into_iter().collect(),
                    _ => exposed.column(x, z).iter().for_each(|&r| out.push_run(r)),
                }
                out.end_column();
            }
        }));
        bad.levels[0].colors.push([0; 3]);
        let faults = |scene, depth| {
            let mut bytes = std::io::Cursor::new(Vec::new());
            write_scene_to(scene, &mut bytes, "a.pcast".as_ref()).unwrap();
            let report = verify(&PcastFile::from_bytes("a.pcast", bytes.into_inner()).unwrap(), depth);
            report.faults.iter().map(Error::to_string).collect::<Vec<_>>()
        };
        assert_eq!(faults(&good, Depth::Exposure), [""; 0]);
        assert_eq!(faults(&bad, Depth::Tiles), [""; 0]);
        let found = faults(&bad, Depth::Exposure);
        assert!(
            found.len() == 1 && found[0].contains("tile (1, 0) of level 0") && found[0].contains("exposed"),
            "{found:?}"
        );
    }

    #[test]
    fn verify_finds_figures_of_heights_that_a_faulty_program_wrote() {
        let columns = Columns::from_fn(300, 50, 9, |x, y, z| y < (x + 3 * z) % 50);
        let scene = build(testing::input(columns, false), &BuildOptions::default()).unwrap();
        let mut bytes = std::io::Cursor::new(Vec::new());
        write_scene_to(&scene, &mut bytes, "a.pcast".as_ref()).unwrap();
        let bytes = bytes.into_inner();
        let file = PcastFile::from_bytes("a.pcast", bytes.clone()).unwrap();
        let entry = file.entries()[0];
        let blob = file.blob(0, 0, 0).unwrap().unwrap();
        assert!(matches!(blob.forms().lists, Lists::Heights { bytes: 1, base: 0 }));
        // One voxel less, one more than the highest, one more than the level is high; checksums as they should be.
        let heights = entry.offset as usize + blob.section(Section::Geometry).as_ptr() as usize
            - file.blob(0, 0, 0).unwrap().unwrap().bytes().as_ptr() as usize;
        for (column, value, what) in [(7, 6, "says"), (49, 50, "says"), (49, 51, "51 high, at most 50 was expected")] {
            let mut bytes = bytes.clone();
            bytes[heights + column] = value;
            testing::reseal(&mut bytes);
            let file = PcastFile::from_bytes("a.pcast", bytes).unwrap();
            assert!(verify(&file, Depth::Checksums).faults.is_empty());
            for depth in [Depth::Tiles, Depth::Exposure] {
                let found = verify(&file, depth).faults;
                assert!(found.len() == 1 && found[0].to_string().contains(what), "{column} {value} {found:?}");
            }
        }

        // Too high, with the figures of that in the directory.
        let mut bytes = bytes;
        bytes[heights + 49] = 51;
        let (n_solid, y_max) = (size_of::<Header>() + 16, size_of::<Header>() + 42);
        bytes[n_solid..n_solid + 8].copy_from_slice(&(entry.n_solid + 2).to_le_bytes());
        bytes[y_max..y_max + 2].copy_from_slice(&50u16.to_le_bytes());
        testing::reseal(&mut bytes);
        let found = verify(&PcastFile::from_bytes("a.pcast", bytes).unwrap(), Depth::Tiles).faults;
        assert!(found.len() == 1 && found[0].to_string().contains("51 high"), "{found:?}");
    }
}
