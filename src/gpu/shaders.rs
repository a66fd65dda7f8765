//! From the files in `shaders/` to modules: includes, conditions, constants and scene tables are put in here.
//!
//! Three directives, each alone on a line: `//!include FILE` puts a file in; `//!if NAME` (or `!NAME`), `//!else`, `//!endif`
//! keep lines for one variant; `//!table NAME TYPE` declares a scene table, over as many bindings as it is cut into, and a function of
//! its name that reads one element. Constants have their home in Rust and are written in front of every shader.

use crate::cpu::remap::HOLE;
use crate::cpu::{matter, normal, refine, shade, shadow, smooth};
use crate::gpu::types::{MAX_LEVELS, NONE, PaintKind, STEEP};
use crate::world::tables::{BLOCK_SHIFT, EMPTY, TILE_SHIFT, UNPAINTED};
use std::fmt::Write;
use wgpu::naga;

macro_rules! files {
    ($($name:literal),* $(,)?) => {
        &[$(($name, include_str!(concat!("../../shaders/", $name)))),*]
    };
}

/// Every shader file, by its path in `shaders/`.
const FILES: &[(&str, &str)] = files![
    "shared/frame.wgsl",
    "shared/plane.wgsl",
    "shared/scene.wgsl",
    "shared/sight.wgsl",
    "shared/place.wgsl",
    "shared/sample.wgsl",
    "shared/ray.wgsl",
    "shared/shadow.wgsl",
    "shared/ground.wgsl",
    "shared/normal.wgsl",
    "traverse_invocation.wgsl",
    "traverse_workgroup.wgsl",
    "raycast.wgsl",
    "raycast_runs.wgsl",
    "remap.wgsl",
    "refine.wgsl",
    "gap_fill.wgsl",
    "shade.wgsl",
    "smooth.wgsl",
    "matter.wgsl",
    "usage.wgsl",
];

/// The first binding of the scene's tables; those below are the shaders' own.
const FIRST_TABLE: u32 = 16;

/// The scene's tables, in the order of their page counts in [`Variant::pages`].
pub const TABLES: [&str; 3] = ["columns", "runs", "paint"];

/// How tables are cut into bindings: pages, and log2 of the elements of a page.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Pages {
    pub n: u32,
    pub shift: u32,
}

impl Pages {
    /// Bytes of a page, of elements of so many.
    pub fn bytes(self, element: u64) -> u64 {
        if self.n == 1 { u64::MAX } else { element << self.shift }
    }
}

/// What a shader's text depends on.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Variant {
    pub defines: Vec<&'static str>,
    pub pages: [Pages; 3],
}

fn header() -> String {
    let rgb = |c: [f32; 3]| format!("vec3<f32>({:?}, {:?}, {:?})", c[0], c[1], c[2]);
    let mut out = String::new();
    let mut constant = |name: &str, value: String| {
        let _ = writeln!(out, "const {name} = {value};");
    };
    constant("MAX_LEVELS", format!("{MAX_LEVELS}u"));
    constant("NONE", format!("{NONE}u"));
    constant("HOLE", format!("{HOLE}u"));
    constant("EMPTY", format!("{EMPTY}u"));
    constant("UNPAINTED", format!("{UNPAINTED}u"));
    constant("BLOCK_SHIFT", format!("{BLOCK_SHIFT}u"));
    constant("BLOCK_SIZE", format!("{}i", 1 << BLOCK_SHIFT));
    constant("TILE_SHIFT", format!("{TILE_SHIFT}u"));
    constant("STEEP", format!("{STEEP:?}f"));
    constant("TINY", "1e-20f".into());
    // In decimal it rounds to more than can be represented, which browsers refuse.
    constant("F32_MAX", "0x1.fffffep+127f".into());
    // As bits: WGSL has no infinity.
    constant("INFINITY", format!("{}u", f32::INFINITY.to_bits()));
    constant("I32_MAX", format!("{}i", i32::MAX));
    for (kind, name) in PaintKind::ALL {
        constant(name, format!("{}u", kind as u32));
    }
    constant("FARTHEST", format!("{:?}f", refine::FARTHEST));
    constant("REFINE_COLUMNS", format!("{}u", refine::COLUMNS));
    constant("REFINE_MARGIN", format!("{:?}f", refine::MARGIN));
    constant("SHADOW_STEPS", format!("{}u", shadow::STEPS));
    constant("SHADOW_BIAS", format!("{:?}f", shadow::BIAS));
    constant("SHADOW_BIAS_BLOCKS", format!("{:?}f", shadow::BIAS_BLOCKS));
    constant("SHADOW_PAST", format!("{:?}f", shadow::PAST[0]));
    constant("SHADOW_PAST_SHARE", format!("{:?}f", shadow::PAST[1]));
    constant("NORMAL_INTO", format!("{:?}f", normal::INTO));
    constant("NORMAL_REACH_SQUARE", format!("{}i", (normal::REACH * normal::REACH) as i32));
    constant("HORIZON_CLEARS", format!("{:?}f", shade::HORIZON_CLEARS));
    constant("FADE_BEGINS", format!("{:?}f", shade::FADE_BEGINS));
    constant("SMOOTH_FIRST", format!("{}u", smooth::FIRST));
    constant("SMOOTH_SQUARE_SHIFT", format!("{}u", smooth::SQUARE_SHIFT));
    constant("SMOOTH_STEPS", format!("{}u", smooth::STEPS));
    constant("MATTER_CLOSED", format!("{:?}f", matter::CLOSED));
    constant("SSAO_STRENGTH", format!("{:?}f", shade::SSAO_STRENGTH));
    constant("SKY_HORIZON", rgb(shade::SKY_HORIZON));
    constant("SKY_ZENITH", rgb(shade::SKY_ZENITH));
    constant("SKY_NADIR", rgb(shade::SKY_NADIR));
    out.push_str("override PAINT: u32 = 0u;\n");
    // Whether voxels are written, work is counted; then the culling switches.
    for name in ["VOXEL", "COUNT", "HORIZON", "CENTER", "FORWARD", "BITS", "COARSE"] {
        let _ = writeln!(out, "override {name}: bool = true;");
    }
    // What a frame can do without: `specialize::Feature`.
    out.push_str(
        "override REPEATS: bool = true;\noverride ONE_LEVEL: bool = false;\noverride UPRIGHT: bool = false;\n",
    );
    out
}

/// The text of shader `name` (without `.wgsl`). Panics where a directive is wrong: the files are part of the program.
pub fn assemble(name: &str, variant: &Variant) -> String {
    let mut out = header();
    let mut binding = FIRST_TABLE;
    append(&format!("{name}.wgsl"), variant, &mut binding, &mut out);
    out
}

fn append(file: &str, variant: &Variant, binding: &mut u32, out: &mut String) {
    let text = FILES.iter().find(|(name, _)| *name == file).unwrap_or_else(|| panic!("no shader file {file}")).1;
    // Whether lines are kept, for each condition that is open.
    let mut kept: Vec<bool> = Vec::new();
    for (number, line) in text.lines().enumerate() {
        let place = || format!("{file}:{}", number + 1);
        let Some(directive) = line.strip_prefix("//!") else {
            if kept.iter().all(|&k| k) {
                out.push_str(line);
                out.push('\n');
            }
            continue;
        };
        let words: Vec<&str> = directive.split_whitespace().collect();
        match words[..] {
            ["if", name] => kept.push(match name.strip_prefix('!') {
                Some(name) => !variant.defines.contains(&name),
                None => variant.defines.contains(&name),
            }),
            ["else"] => {
                let last = kept.last_mut().unwrap_or_else(|| panic!("{}: else without if", place()));
                *last = !*last;
            }
            ["endif"] => assert!(kept.pop().is_some(), "{}: endif without if", place()),
            _ if !kept.iter().all(|&k| k) => {}
            ["include", name] => append(name, variant, binding, out),
            ["table", name, ty] => {
                let at = TABLES.iter().position(|t| *t == name);
                let pages = variant.pages[at.unwrap_or_else(|| panic!("{}: no table {name}", place()))];
                table(name, ty, pages, binding, out);
            }
            _ => panic!("{}: unknown directive {directive}", place()),
        }
    }
    assert!(kept.is_empty(), "{file}: if without endif");
}

/// Declares a table's bindings and the function that reads it.
fn table(name: &str, ty: &str, pages: Pages, binding: &mut u32, out: &mut String) {
    for page in 0..pages.n {
        let _ = writeln!(out, "@group(0) @binding({binding}) var<storage, read> {name}_{page}: array<{ty}>;");
        *binding += 1;
    }
    let _ = writeln!(out, "fn {name}(i: u32) -> {ty} {{");
    if pages.n > 1 {
        let _ = writeln!(out, "    let at = i & {}u;", (1u64 << pages.shift) - 1);
        let _ = writeln!(out, "    switch (i >> {}u) {{", pages.shift);
        for page in 1..pages.n {
            let _ = writeln!(out, "        case {page}u: {{ return {name}_{page}[at]; }}");
        }
        let _ = writeln!(out, "        default: {{ return {name}_0[at]; }}\n    }}\n}}");
    } else {
        let _ = writeln!(out, "    return {name}_0[i];\n}}");
    }
}

/// The buffers that a shader's entry point uses, by binding: WGSL is the only list of them.
pub fn bindings(source: &str) -> Result<Vec<(u32, String)>, String> {
    let (module, info) = parse(source)?;
    let entry = info.get_entry_point(0);
    let used = module.global_variables.iter().filter(|(handle, _)| !entry[*handle].is_empty());
    Ok(used.filter_map(|(_, variable)| Some((variable.binding.as_ref()?.binding, variable.name.clone()?))).collect())
}

fn parse(source: &str) -> Result<(naga::Module, naga::valid::ModuleInfo), String> {
    use naga::valid::{Capabilities, ValidationFlags, Validator};
    let module = naga::front::wgsl::parse_str(source).map_err(|e| e.emit_to_string(source))?;
    let info = Validator::new(ValidationFlags::all(), Capabilities::empty())
        .validate(&module)
        .map_err(|e| e.emit_to_string(source))?;
    Ok((module, info))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gpu::types;
    use wgpu::naga;

    fn variants() -> Vec<Variant> {
        let one = [Pages { n: 1, shift: 31 }; 3];
        let many = [Pages { n: 3, shift: 20 }; 3];
        let mut all = Vec::new();
        for pages in [one, many] {
            for tables in [&[][..], &["HEIGHTS"], &["HEIGHTS", "GROUND"], &["PAGED"], &["HEIGHTS", "GROUND", "PAGED"]] {
                for memory in [&[][..], &["STORAGE_BITS", "STORAGE_KEYS", "UNIFORM"]] {
                    for remap in [
                        &[][..],
                        &["RETEST"],
                        &["RETEST", "REFINE"],
                        &["RETEST", "REFINE", "PACKED", "LATE_COLOR"],
                        &["INDEX", "RUN_COLORS"],
                        &["SCENE", "SHADOWS"],
                        &["SCENE", "DERIVED_NORMALS"],
                        &["SCENE", "SHADOWS", "SMOOTH_NORMALS"],
                        &["SCENE", "SMOOTH_NORMALS", "FRACTIONS"],
                        &["GATHER"],
                    ] {
                        all.push(Variant { defines: [tables, memory, remap].concat(), pages });
                    }
                }
            }
        }
        all
    }

    const STAGES: [&str; 11] = [
        "traverse_invocation",
        "traverse_workgroup",
        "raycast",
        "raycast_runs",
        "remap",
        "refine",
        "gap_fill",
        "shade",
        "smooth",
        "matter",
        "usage",
    ];

    #[test]
    fn shaders_are_valid_in_every_variant() {
        for variant in variants() {
            for stage in STAGES {
                // The surface is that of heights.
                if !variant.defines.contains(&"HEIGHTS")
                    && (stage == "smooth" || variant.defines.contains(&"SMOOTH_NORMALS"))
                {
                    continue;
                }
                if stage == "usage" && !variant.defines.contains(&"PAGED") {
                    continue;
                }
                let source = assemble(stage, &variant);
                if let Err(e) = parse(&source) {
                    panic!("{stage} {variant:?}\n{e}");
                }
            }
        }
    }

    #[test]
    fn shaders_that_are_broken_are_rejected() {
        let mut source = assemble("shade", &variants()[0]);
        source.push_str("fn broken() -> u32 { return 1.5; }");
        assert!(parse(&source).is_err());
    }

    #[test]
    fn bindings_are_those_that_an_entry_point_uses() {
        let names: Vec<String> =
            bindings(&assemble("shade", &variants()[0])).unwrap().into_iter().map(|b| b.1).collect();
        assert_eq!(names, ["frame", "image_color", "image_depth", "shaded", "spiral"]);
        let paged = variants().into_iter().find(|v| v.pages[0].n == 3).unwrap();
        let pages = bindings(&assemble("raycast_runs", &paged)).unwrap();
        assert_eq!(pages.iter().filter(|(_, name)| name.starts_with("columns_")).count(), 3);
    }

    /// Name, offset of each member, size of a struct.
    type Layout = (Vec<(String, u32)>, u32);

    fn layout(module: &naga::Module, name: &str) -> Option<Layout> {
        module.types.iter().find_map(|(_, ty)| match &ty.inner {
            naga::TypeInner::Struct { members, span } if ty.name.as_deref() == Some(name) => {
                Some((members.iter().map(|m| (m.name.clone().unwrap(), m.offset)).collect(), *span))
            }
            _ => None,
        })
    }

    macro_rules! rust_layout {
        ($ty:ident { $($field:ident),* $(,)? }) => {
            (
                vec![$((stringify!($field).to_string(), std::mem::offset_of!(types::$ty, $field) as u32)),*],
                size_of::<types::$ty>() as u32,
            )
        };
    }

    fn rust_layouts() -> Vec<(&'static str, Layout)> {
        vec![
            (
                "Level",
                rust_layout!(Level {
                    size,
                    columns,
                    runs,
                    blocks,
                    blocks_row,
                    bottom,
                    top,
                    paint,
                    exposed,
                    colors,
                    pages
                }),
            ),
            (
                "Plane",
                rust_layout!(Plane {
                    dir,
                    inverse,
                    a,
                    b,
                    c,
                    e,
                    delta,
                    t_start,
                    t_end,
                    lod_t,
                    first,
                    end,
                    base,
                    lod_first,
                    cell,
                    turn,
                    _pad0
                }),
            ),
            (
                "Fan",
                rust_layout!(FanParams {
                    first_plane,
                    n_planes,
                    n_samples,
                    first_sample,
                    flip,
                    bounds,
                    spacing,
                    pixels
                }),
            ),
            ("Line", rust_layout!(Line { at_hi, at_lo, step_hi, step_lo, anchor, to, fan, narrow })),
            (
                "Frame",
                rust_layout!(FrameParams {
                    fans,
                    eye_cell,
                    n_planes,
                    eye_fract,
                    levels,
                    ray_origin,
                    width,
                    ray_right,
                    height,
                    ray_down,
                    equidistant,
                    bottom,
                    top,
                    repeat_x,
                    repeat_z,
                    offset_x,
                    offset_z,
                    samples,
                    sparse,
                    start,
                    step,
                    up,
                    pixel,
                    sun,
                    radius_px,
                    fog,
                    ambient,
                    sky,
                    view_distance,
                    axis_right,
                    size,
                    axis_up,
                    top_levels,
                    axis_forward,
                    world_top,
                    sun_world,
                    shadow_end,
                    surface_levels,
                    surface_top,
                    smooth_near,
                    _pad0
                }),
            ),
        ]
    }

    #[test]
    fn layouts_agree_between_rust_and_wgsl() {
        let (module, _) = parse(&assemble("raycast", &variants()[0])).unwrap();
        for (name, rust) in rust_layouts() {
            let wgsl = layout(&module, name).unwrap_or_else(|| panic!("no WGSL struct {name}"));
            assert_eq!(wgsl, rust, "{name}");
        }
    }

    #[test]
    fn layouts_that_differ_are_found() {
        let source = assemble("raycast", &variants()[0]).replacen("    at_lo: u32,\n", "", 1);
        let module = naga::front::wgsl::parse_str(&source);
        // `at_lo` is read: dropping it breaks the shader, so the planted struct is read alone.
        assert!(module.is_err());
        let planted = naga::front::wgsl::parse_str("struct Line { at_lo: u32, at_hi: i32, } fn f(l: Line) {}").unwrap();
        let rust = rust_layouts().into_iter().find(|(name, _)| *name == "Line").unwrap().1;
        assert_ne!(layout(&planted, "Line").unwrap(), rust);
    }
}
