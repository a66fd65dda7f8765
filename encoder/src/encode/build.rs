//! From an input to a scene: exposure, colours, levels.

use crate::encode::mips;
use crate::model::exposure;
use crate::{ColorMode, Colors, Columns, Encoding, Error, Input, Level, MipRule, Result, Rgb, Scene};

/// What to make of an input.
#[derive(Clone, Copy, Debug)]
pub struct BuildOptions {
    pub encoding: Encoding,
    /// None: as the input has it, [`ColorMode::Voxel`] if it has colours at all.
    pub color: Option<ColorMode>,
    pub mip_rule: MipRule,
}

impl Default for BuildOptions {
    fn default() -> BuildOptions {
        BuildOptions { encoding: Encoding::Solid, color: None, mip_rule: MipRule::Any }
    }
}

impl BuildOptions {
    /// How finely a scene is coloured whose input has colours or not.
    pub fn color_of(&self, colored: bool) -> Result<ColorMode> {
        match (self.color, colored) {
            (None, false) => Ok(ColorMode::None),
            (None, true) => Ok(ColorMode::Voxel),
            (Some(mode @ (ColorMode::Run | ColorMode::Voxel)), false) => {
                let mode = if mode == ColorMode::Run { "run" } else { "voxel" };
                Err(Error::Argument(format!("the input has no colours, but --color {mode} asks for them")))
            }
            (Some(mode), _) => Ok(mode),
        }
    }
}

/// Colour of the exposed voxels of a column for which [`Colors::Voxel`] has no entry at all.
pub const UNCOLORED: Rgb = [128; 3];

/// The scene of `input` with all its levels.
///
/// Run colours are means over the exposed voxels of a run; those of a coarse level derive from its voxel colours,
/// not from the run colours of the finer one.
pub fn build(input: Input, opts: &BuildOptions) -> Result<Scene> {
    let Input { columns, colors, .. } = input;
    let [nx, ny, nz] = columns.dims();
    if nx == 0 || ny == 0 || nz == 0 {
        return Err(Error::Argument(format!("the input is {nx} × {ny} × {nz}; a world has at least one voxel")));
    }
    let color = opts.color_of(!matches!(colors, Colors::None))?;

    let mut solid = vec![columns];
    for k in 1..mips::n_levels([nx, ny, nz]) as usize {
        solid.push(mips::next(&solid[k - 1], opts.mip_rule));
    }
    let exposed: Vec<Columns> = if color == ColorMode::None && opts.encoding == Encoding::Solid {
        Vec::new()
    } else {
        solid.iter().map(exposure::exposed).collect()
    };
    let mut voxel_colors: Vec<Vec<Rgb>> = Vec::new();
    if color != ColorMode::None {
        voxel_colors.push(input_colors(&colors, &solid[0], &exposed[0])?);
        for k in 1..solid.len() {
            voxel_colors.push(mips::next_colors(&exposed[k], &exposed[k - 1], &voxel_colors[k - 1]));
        }
    }

    let mut exposed = exposed.into_iter();
    let mut voxel_colors = voxel_colors.into_iter();
    let levels = solid
        .into_iter()
        .map(|solid| {
            let colors = voxel_colors.next().unwrap_or_default();
            let mut level = Level { solid, exposed: exposed.next(), colors, matter: None };
            if color == ColorMode::Run {
                let shown = level.exposed.as_ref().expect("coloured levels have exposed runs");
                level.colors = mips::run_colors(level.geometry(opts.encoding), shown, &level.colors);
                level.exposed.take_if(|_| opts.encoding == Encoding::Solid);
            }
            level
        })
        .collect();
    Ok(Scene { encoding: opts.encoding, color, mip_rule: opts.mip_rule, levels, classes: None })
}

/// One colour an exposed voxel of level 0.
pub(crate) fn input_colors(colors: &Colors, solid: &Columns, exposed: &Columns) -> Result<Vec<Rgb>> {
    let expect = |what: &str, found: usize, expected: usize| {
        (found == expected)
            .then_some(())
            .ok_or_else(|| Error::Argument(format!("the input has {found} {what} colours, {expected} were expected")))
    };
    let n_columns = solid.offsets().len() - 1;
    let voxels = |x: u32, z: u32| exposed.column(x, z).iter().flat_map(|r| u32::from(r.first())..r.end());
    match colors {
        Colors::None => unreachable!("checked by the caller"),
        Colors::Column(of) => {
            expect("column", of.len(), n_columns)?;
            Ok(mips::rows(exposed, |x, z, out| out.extend(voxels(x, z).map(|_| of[exposed.index(x, z)]))))
        }
        Colors::Run(of) => {
            expect("run", of.len(), solid.runs().len())?;
            Ok(mips::rows(exposed, |x, z, out| {
                let runs = solid.range(solid.index(x, z));
                let mut i = runs.start;
                for run in exposed.column(x, z) {
                    while solid.runs()[i].last() < run.first() {
                        i += 1;
                    }
                    out.extend(std::iter::repeat_n(of[i], run.len() as usize));
                }
            }))
        }
        Colors::Voxel { offsets, entries } => {
            if offsets.len() != n_columns + 1
                || !offsets.is_sorted()
                || offsets.last().map(|&n| n as usize) != Some(entries.len())
            {
                return Err(Error::Argument("the input's voxel colours do not fit its columns".into()));
            }
            Ok(mips::rows(exposed, |x, z, out| {
                let ix = exposed.index(x, z);
                let entries = &entries[offsets[ix] as usize..offsets[ix + 1] as usize];
                let mut above = 0;
                out.extend(voxels(x, z).map(|y| {
                    while entries.get(above).is_some_and(|e| u32::from(e.0) < y) {
                        above += 1;
                    }
                    let up = entries.get(above).map(|e| (u32::from(e.0) - y, e.1));
                    let down = above.checked_sub(1).map(|i| (y - u32::from(entries[i].0), entries[i].1));
                    [up, down].into_iter().flatten().min_by_key(|n| n.0).map_or(UNCOLORED, |n| n.1)
                }));
            }))
        }
        Colors::Function(of) => Ok(mips::rows(exposed, |x, z, out| out.extend(voxels(x, z).map(|y| of(x, y, z))))),
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::model::srgb::Mean;
    use crate::testing::{self, color_of, voxel_positions};
    use crate::{ColumnsBuilder, Run};

    fn one_column(ny: u32, runs: &[(u16, u16)]) -> Columns {
        let mut out = ColumnsBuilder::new(1, ny, 1);
        runs.iter().for_each(|&(a, b)| out.push_run(Run::new(a, b)));
        out.end_column();
        out.finish()
    }

    fn colored(columns: Columns, colors: Colors, color: ColorMode) -> Result<Scene> {
        let opts = BuildOptions { color: Some(color), ..Default::default() };
        build(Input { columns, colors, notes: Vec::new() }, &opts)
    }

    proptest! {
        #[test]
        fn build_colors_every_exposed_voxel_with_its_own(columns in testing::small_world(), surface in any::<bool>()) {
            let encoding = if surface { Encoding::Surface } else { Encoding::Solid };
            let opts = BuildOptions { encoding, ..Default::default() };
            let scene = build(testing::input(columns.clone(), true), &opts).unwrap();
            prop_assert_eq!(scene.color, ColorMode::Voxel);
            prop_assert_eq!(&scene.levels[0].solid, &columns);
            for level in &scene.levels {
                prop_assert_eq!(level.exposed.as_ref().unwrap(), &exposure::exposed(&level.solid));
                prop_assert_eq!(level.colors.len() as u64, level.exposed.as_ref().unwrap().voxels());
            }
            for ((x, y, z), i) in voxel_positions(scene.levels[0].exposed.as_ref().unwrap()) {
                prop_assert_eq!(scene.levels[0].colors[i], color_of(x, y, z));
            }
        }

        #[test]
        fn build_run_colors_are_means_of_exposed_voxels(columns in testing::small_world(), surface in any::<bool>()) {
            let encoding = if surface { Encoding::Surface } else { Encoding::Solid };
            let opts = BuildOptions { encoding, color: Some(ColorMode::Run), ..Default::default() };
            let scene = build(testing::input(columns.clone(), true), &opts).unwrap();
            prop_assert_eq!(scene.levels[0].exposed.is_some(), surface);
            let exposed = exposure::exposed(&columns);
            let geometry = scene.levels[0].geometry(encoding);
            prop_assert_eq!(scene.levels[0].colors.len(), geometry.runs().len());
            for z in 0..columns.nz() {
                for x in 0..columns.nx() {
                    for i in geometry.range(geometry.index(x, z)) {
                        let mut mean = Mean::default();
                        (u32::from(geometry.runs()[i].first())..geometry.runs()[i].end())
                            .filter(|&y| exposed.find(x, y, z).is_some())
                            .for_each(|y| mean.add(color_of(x, y, z)));
                        prop_assert_eq!(Some(scene.levels[0].colors[i]), mean.get());
                    }
                }
            }
        }
    }

    #[test]
    fn build_takes_the_nearest_voxel_color_upper_first() {
        let colors = Colors::Voxel { offsets: vec![0, 2], entries: vec![(1, [1; 3]), (5, [5; 3])] };
        let scene = colored(one_column(8, &[(0, 6)]), colors, ColorMode::Voxel).unwrap();
        assert_eq!(scene.levels[0].colors, [1, 1, 1, 5, 5, 5, 5].map(|c| [c; 3]));
    }

    #[test]
    fn build_takes_column_and_run_colors() {
        let runs = [(0, 1), (3, 3)];
        let scene = colored(one_column(8, &runs), Colors::Run(vec![[1; 3], [2; 3]]), ColorMode::Voxel).unwrap();
        assert_eq!(scene.levels[0].colors, [[1; 3], [1; 3], [2; 3]]);
        let scene = colored(one_column(8, &runs), Colors::Run(vec![[1; 3], [2; 3]]), ColorMode::Run).unwrap();
        assert_eq!(scene.levels[0].colors, [[1; 3], [2; 3]]);
        let scene = colored(one_column(8, &runs), Colors::Column(vec![[9; 3]]), ColorMode::Voxel).unwrap();
        assert_eq!(scene.levels[0].colors, [[9; 3]; 3]);
    }

    #[test]
    fn build_refuses_colors_that_are_not_there_or_do_not_fit() {
        let refused = |colors| match colored(one_column(8, &[(0, 1)]), colors, ColorMode::Voxel) {
            Err(Error::Argument(what)) => what,
            other => panic!("{other:?}"),
        };
        assert_eq!(refused(Colors::None), "the input has no colours, but --color voxel asks for them");
        assert_eq!(refused(Colors::Column(vec![])), "the input has 0 column colours, 1 were expected");
        assert_eq!(refused(Colors::Run(vec![[0; 3]; 2])), "the input has 2 run colours, 1 were expected");
        let unfit = Colors::Voxel { offsets: vec![0, 2], entries: vec![] };
        assert_eq!(refused(unfit), "the input's voxel colours do not fit its columns");
    }

    #[test]
    fn build_without_colors_has_levels_down_to_one_column() {
        let scene = build(testing::input(Columns::from_fn(5, 9, 3, |_, y, _| y < 4), false), &Default::default());
        let scene = scene.unwrap();
        assert_eq!(scene.color, ColorMode::None);
        let dims: Vec<_> = scene.levels.iter().map(|l| l.solid.dims()).collect();
        assert_eq!(dims, [[5, 9, 3], [3, 5, 2], [2, 3, 1], [1, 2, 1]]);
        assert!(scene.levels.iter().all(|l| l.exposed.is_none() && l.colors.is_empty()));
    }
}
