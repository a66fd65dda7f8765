//! Worlds read piece by piece, so that none need fit into memory.

use std::ops::Range;
use std::sync::Arc;

use crate::encode::build::UNCOLORED;
use crate::model::grid::Grid;
use crate::model::matter::{self, Matter};
use crate::{About, Colors, Columns, ColumnsBuilder, Input, Result, Rgb};

/// A world that can be read in pieces, in any order, by several threads.
pub trait Pieces: Send + Sync {
    /// `[nx, ny, nz]`, at most 65,536 high and 2³¹ columns.
    fn dims(&self) -> [u32; 3];

    /// Whether its pieces have colours.
    fn colored(&self) -> bool;

    /// Facts a person should be told about the reading.
    fn notes(&self) -> &[String];

    /// What the input is, and how it was read; nothing is known of worlds made in memory.
    fn about(&self) -> About {
        About::default()
    }

    /// The columns `xs × zs` as a world of their own, with colours where there are any.
    fn piece(&self, xs: Range<u32>, zs: Range<u32>) -> Result<Input>;

    /// How high columns are, where each is solid from 0 up, or empty: then nobody need make runs of them.
    fn heights(&self) -> Option<&HeightsFn> {
        None
    }

    /// The translucent matter of the columns `xs × zs`, of worlds that say its classes ([`About::classes`]); others have none.
    fn matter(&self, xs: Range<u32>, zs: Range<u32>) -> Result<Option<Matter>> {
        let _ = (xs, zs);
        Ok(None)
    }

    /// Bytes of the whole input, as far as they are read; 0 for functions.
    fn input_bytes(&self) -> u64 {
        0
    }

    /// The values behind a volume that has at most `most` voxels; None of anything else.
    fn grid(&self, most: u64) -> Result<Option<Grid>> {
        let _ = most;
        Ok(None)
    }

    /// Rows of z that are best read together, where the columns lie across the order of the file.
    fn rows_together(&self) -> u32 {
        1
    }
}

/// The whole of a world as one input.
pub fn whole(pieces: &dyn Pieces) -> Result<Input> {
    let [nx, _, nz] = pieces.dims();
    let mut input = pieces.piece(0..nx, 0..nz)?;
    input.notes = pieces.notes().to_vec();
    Ok(input)
}

/// A world in memory, cut into pieces.
pub struct InMemory {
    input: Arc<Input>,
    about: About,
    matter: Option<Matter>,
}

impl InMemory {
    pub fn new(input: Input) -> InMemory {
        InMemory { input: Arc::new(input), about: About::default(), matter: None }
    }

    /// The same, of which this is known.
    pub fn about(self, about: About) -> InMemory {
        InMemory { about, ..self }
    }

    /// The same with translucent matter, whose classes [`About`] says.
    pub fn matter(self, matter: Matter) -> InMemory {
        InMemory { matter: Some(matter), ..self }
    }
}

impl Pieces for InMemory {
    fn dims(&self) -> [u32; 3] {
        self.input.columns.dims()
    }

    fn colored(&self) -> bool {
        !matches!(self.input.colors, Colors::None)
    }

    fn notes(&self) -> &[String] {
        &self.input.notes
    }

    fn about(&self) -> About {
        self.about.clone()
    }

    fn matter(&self, xs: Range<u32>, zs: Range<u32>) -> Result<Option<Matter>> {
        Ok(self.matter.as_ref().map(|matter| matter.crop(xs, zs)))
    }

    fn piece(&self, xs: Range<u32>, zs: Range<u32>) -> Result<Input> {
        let all = &self.input.columns;
        let columns = all.crop(xs.clone(), zs.clone());
        let rows = || zs.clone().map(|z| all.index(xs.start, z)..all.index(xs.start, z) + xs.len());
        let colors = match &self.input.colors {
            Colors::None => Colors::None,
            Colors::Column(of) => Colors::Column(rows().flat_map(|row| of[row].iter().copied()).collect()),
            Colors::Run(of) => {
                let runs = |row: Range<usize>| all.offsets()[row.start] as usize..all.offsets()[row.end] as usize;
                Colors::Run(rows().flat_map(|row| of[runs(row)].iter().copied()).collect())
            }
            Colors::Voxel { offsets, entries } => {
                let (mut own, mut own_entries) = (vec![0], Vec::new());
                for row in rows() {
                    let base = own_entries.len() as u32;
                    own.extend(offsets[row.start + 1..=row.end].iter().map(|o| base + (o - offsets[row.start])));
                    own_entries.extend_from_slice(&entries[offsets[row.start] as usize..offsets[row.end] as usize]);
                }
                Colors::Voxel { offsets: own, entries: own_entries }
            }
            Colors::Function(_) => {
                let input = Arc::clone(&self.input);
                Colors::Function(Box::new(move |x, y, z| match &input.colors {
                    Colors::Function(of) => of(x + xs.start, y, z + zs.start),
                    _ => unreachable!("the colours are a function"),
                }))
            }
        };
        Ok(Input { columns, colors, notes: Vec::new() })
    }
}

/// Makes columns `xs` of row `z`, one after the other, in the builder it is given.
pub type RowFn = dyn Fn(Range<u32>, u32, &mut ColumnsBuilder) -> Result<()> + Send + Sync;

/// Tells how many voxels are solid of each of the columns from `x` on of row `z`.
pub type HeightsFn = dyn Fn(u32, u32, &mut [u16]) -> Result<()> + Send + Sync;

/// The colour of a voxel of the world.
pub type ColorFn = dyn Fn(u32, u32, u32) -> Rgb + Send + Sync;

/// Appends a colour for each of the columns `xs` of row `z`.
pub type ColumnColorsFn = dyn Fn(Range<u32>, u32, &mut Vec<Rgb>) -> Result<()> + Send + Sync;

/// Colours of [`Rows`].
pub enum RowColors {
    None,
    Voxel(Arc<ColorFn>),
    Column(Box<ColumnColorsFn>),
}

/// A world whose rows are made by a function when they are asked for.
pub struct Rows {
    pub dims: [u32; 3],
    pub row: Box<RowFn>,
    /// The same, where columns are that simple.
    pub heights: Option<Box<HeightsFn>>,
    pub color: RowColors,
    pub notes: Vec<String>,
    pub about: About,
    pub input_bytes: u64,
    /// Voxels from the ground up that water reaches, of worlds that say its class.
    pub water: Option<u32>,
}

impl Pieces for Rows {
    fn dims(&self) -> [u32; 3] {
        self.dims
    }

    fn colored(&self) -> bool {
        !matches!(self.color, RowColors::None)
    }

    fn notes(&self) -> &[String] {
        &self.notes
    }

    fn about(&self) -> About {
        self.about.clone()
    }

    fn piece(&self, xs: Range<u32>, zs: Range<u32>) -> Result<Input> {
        let columns = Columns::try_from_rows([xs.len() as u32, self.dims[1], zs.len() as u32], |z, out| {
            (self.row)(xs.clone(), z + zs.start, out)
        })?;
        let colors = match &self.color {
            RowColors::None => Colors::None,
            RowColors::Voxel(color) => {
                let color = Arc::clone(color);
                Colors::Function(Box::new(move |x, y, z| color(x + xs.start, y, z + zs.start)))
            }
            RowColors::Column(of) => {
                let mut colors = Vec::with_capacity(xs.len() * zs.len());
                zs.into_iter().try_for_each(|z| of(xs.clone(), z, &mut colors))?;
                Colors::Column(colors)
            }
        };
        Ok(Input { columns, colors, notes: Vec::new() })
    }

    fn matter(&self, xs: Range<u32>, zs: Range<u32>) -> Result<Option<Matter>> {
        let Some(level) = self.water else { return Ok(None) };
        let columns = Columns::try_from_rows([xs.len() as u32, self.dims[1], zs.len() as u32], |z, out| {
            (self.row)(xs.clone(), z + zs.start, out)
        })?;
        Ok(Some(matter::water(&columns, level)))
    }

    fn heights(&self) -> Option<&HeightsFn> {
        self.heights.as_deref()
    }

    fn input_bytes(&self) -> u64 {
        self.input_bytes
    }
}

/// A world of which more is known than its reader says, or that lives on something that must not go before it.
struct Known {
    world: Box<dyn Pieces>,
    about: About,
    _lives_on: Option<Box<dyn Send + Sync>>,
}

/// A world that keeps what it lives on, such as a folder of files.
#[cfg(all(feature = "object-store", not(target_arch = "wasm32")))]
pub(crate) fn keeping(world: Box<dyn Pieces>, lives_on: impl Send + Sync + 'static) -> Box<dyn Pieces> {
    Box::new(Known { about: world.about(), world, _lives_on: Some(Box::new(lives_on)) })
}

impl Pieces for Known {
    fn dims(&self) -> [u32; 3] {
        self.world.dims()
    }

    fn colored(&self) -> bool {
        self.world.colored()
    }

    fn notes(&self) -> &[String] {
        self.world.notes()
    }

    fn about(&self) -> About {
        self.about.clone()
    }

    fn piece(&self, xs: Range<u32>, zs: Range<u32>) -> Result<Input> {
        self.world.piece(xs, zs)
    }

    fn matter(&self, xs: Range<u32>, zs: Range<u32>) -> Result<Option<Matter>> {
        self.world.matter(xs, zs)
    }

    fn heights(&self) -> Option<&HeightsFn> {
        self.world.heights()
    }

    fn input_bytes(&self) -> u64 {
        self.world.input_bytes()
    }

    fn grid(&self, most: u64) -> Result<Option<Grid>> {
        self.world.grid(most)
    }

    fn rows_together(&self) -> u32 {
        self.world.rows_together()
    }
}

/// A world that says what its input is called: without folder, host and query, which are not everybody's business and differ
/// from machine to machine.
#[cfg(not(target_arch = "wasm32"))]
pub fn named(world: Box<dyn Pieces>, name: &std::path::Path) -> Box<dyn Pieces> {
    let mut about = world.about();
    if about == About::default() {
        if !crate::encode::open::is_procedural(name) {
            return world;
        }
        about.kind = Some(crate::model::about::Kind::Procedural);
    }
    let text = name.to_string_lossy();
    about.source = match crate::store::remote::is_url(name) {
        true => text
            .split(['?', '#'])
            .next()
            .unwrap_or_default()
            .trim_end_matches('/')
            .rsplit('/')
            .next()
            .map(str::to_owned),
        false if crate::encode::open::is_procedural(name) => Some(text.into_owned()),
        false => name.file_name().map(|name| name.to_string_lossy().into_owned()),
    }
    .unwrap_or_default();
    Box::new(Known { world, about, _lives_on: None })
}

/// A world with water over columns that end below a level.
pub struct Flooded {
    pub world: Box<dyn Pieces>,
    pub about: About,
    /// Voxels from the ground up that water reaches.
    pub level: u32,
}

impl Pieces for Flooded {
    fn dims(&self) -> [u32; 3] {
        let [nx, ny, nz] = self.world.dims();
        [nx, ny.max(self.level), nz]
    }

    fn colored(&self) -> bool {
        self.world.colored()
    }

    fn notes(&self) -> &[String] {
        self.world.notes()
    }

    fn about(&self) -> About {
        self.about.clone()
    }

    fn piece(&self, xs: Range<u32>, zs: Range<u32>) -> Result<Input> {
        let input = self.world.piece(xs, zs)?;
        let [nx, _, nz] = input.columns.dims();
        let columns = Columns::from_parts(
            nx,
            self.dims()[1],
            nz,
            input.columns.offsets().to_vec(),
            input.columns.runs().to_vec(),
        );
        Ok(Input { columns, ..input })
    }

    fn matter(&self, xs: Range<u32>, zs: Range<u32>) -> Result<Option<Matter>> {
        Ok(Some(matter::water(&self.piece(xs, zs)?.columns, self.level)))
    }

    fn input_bytes(&self) -> u64 {
        self.world.input_bytes()
    }

    fn rows_together(&self) -> u32 {
        self.world.rows_together()
    }
}

/// A world without colours, all of it grey.
pub struct Grey(pub Box<dyn Pieces>);

impl Pieces for Grey {
    fn dims(&self) -> [u32; 3] {
        self.0.dims()
    }

    fn colored(&self) -> bool {
        true
    }

    fn notes(&self) -> &[String] {
        self.0.notes()
    }

    fn about(&self) -> About {
        self.0.about()
    }

    fn piece(&self, xs: Range<u32>, zs: Range<u32>) -> Result<Input> {
        Ok(Input { colors: Colors::Function(Box::new(|_, _, _| UNCOLORED)), ..self.0.piece(xs, zs)? })
    }

    fn matter(&self, xs: Range<u32>, zs: Range<u32>) -> Result<Option<Matter>> {
        self.0.matter(xs, zs)
    }

    fn heights(&self) -> Option<&HeightsFn> {
        self.0.heights()
    }

    fn input_bytes(&self) -> u64 {
        self.0.input_bytes()
    }

    fn rows_together(&self) -> u32 {
        self.0.rows_together()
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::testing;

    proptest! {
        #[test]
        fn pieces_of_a_world_are_cut_out_of_it(columns in testing::small_world(), a in 0u32..6, b in 0u32..6) {
            let world = InMemory::new(testing::input(columns.clone(), true));
            let (x0, z0) = (a % columns.nx(), b % columns.nz());
            let piece = world.piece(x0..columns.nx(), z0..columns.nz()).unwrap();
            for z in z0..columns.nz() {
                for x in x0..columns.nx() {
                    prop_assert_eq!(piece.columns.column(x - x0, z - z0), columns.column(x, z));
                }
            }
            let Colors::Function(color) = piece.colors else { panic!("colours are kept") };
            prop_assert_eq!(color(0, 3, 0), testing::color_of(x0, 3, z0));
            let all = whole(&world).unwrap();
            prop_assert_eq!(all.columns, columns);
        }
    }

    #[test]
    fn pieces_keep_column_run_and_voxel_colors() {
        let columns = Columns::from_fn(3, 9, 2, |x, y, z| y <= x || y > 5 + z);
        let color = |i: usize| [i as u8; 3];
        let n_runs = columns.runs().len();
        let piece = |colors: Colors| {
            let world = InMemory::new(Input { columns: columns.clone(), colors, notes: Vec::new() });
            world.piece(1..3, 1..2).unwrap().colors
        };
        let Colors::Column(of) = piece(Colors::Column((0..6).map(color).collect())) else { panic!() };
        assert_eq!(of, [4, 5].map(color));
        let Colors::Run(of) = piece(Colors::Run((0..n_runs).map(color).collect())) else { panic!() };
        assert_eq!(of, (columns.range(4).start..n_runs).map(color).collect::<Vec<_>>());
        let entries = vec![(0, color(0)), (0, color(1)), (1, color(2)), (0, color(3))];
        let offsets = vec![0, 1, 1, 1, 1, 3, 4];
        let Colors::Voxel { offsets, entries } = piece(Colors::Voxel { offsets, entries }) else { panic!() };
        assert_eq!((offsets, entries), (vec![0, 2, 3], vec![(0, color(1)), (1, color(2)), (0, color(3))]));
    }
}
