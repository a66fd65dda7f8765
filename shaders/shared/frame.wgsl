// What all planes and pixels of a frame share. Rust side: src/gpu/types.rs, joined field by field in its tests.

struct Fan {
    first_plane: u32,
    n_planes: u32,
    n_samples: u32,
    first_sample: u32,
    // 1: samples count against the pixel axis.
    flip: u32,
    // Where the fan's stripes stand in `lines`, or NONE where they are all of one width.
    bounds: u32,
    spacing: f32,
    // Pixels along a plane.
    pixels: u32,
}

struct Frame {
    fans: array<Fan, 4>,
    eye_cell: vec3<i32>,
    n_planes: u32,
    eye_fract: vec3<f32>,
    levels: u32,
    // The ray of pixel (x, y) in the world: origin + x·right + y·down; component along forward is 1.
    ray_origin: vec3<f32>,
    width: u32,
    ray_right: vec3<f32>,
    height: u32,
    ray_down: vec3<f32>,
    equidistant: f32,
    // Lowest and highest place of any voxel above the eye, whatever the level.
    bottom: f32,
    top: f32,
    // Whether x and z repeat.
    repeat_x: u32,
    repeat_z: u32,
    // From the first period to the unrepeated world.
    offset_x: i32,
    offset_z: i32,
    samples: u32,
    // 1: pixels that no plane passes within half a pixel are left for gap_fill.
    sparse: u32,
    // Shading: see `ShadeParams`.
    start: vec2<f32>,
    step: vec2<f32>,
    up: vec3<f32>,
    pixel: f32,
    sun: vec3<f32>,
    radius_px: f32,
    fog: f32,
    ambient: f32,
    // 0: the sky is transparent.
    sky: u32,
    view_distance: f32,
    // The camera's axes and the sun in the world.
    axis_right: vec3<f32>,
    // Size of a voxel drawn at depth 1.
    size: f32,
    axis_up: vec3<f32>,
    // Levels of `tops`.
    top_levels: u32,
    axis_forward: vec3<f32>,
    world_top: f32,
    sun_world: vec3<f32>,
    // Where walks towards the sun end.
    shadow_end: f32,
    // Levels of `surface_tops`, 0 where no surface is drawn, the highest of them, and up to what depth it is drawn.
    surface_levels: u32,
    surface_top: f32,
    smooth_near: f32,
    _pad0: u32,
}

@group(0) @binding(0) var<uniform> frame: Frame;

// Height above the eye of the face below voxel y of level 0.
fn height(y: i32) -> f32 {
    return f32(y - frame.eye_cell.y) - frame.eye_fract.y;
}

// A device that ends loops after a number of turns and then goes on with what it has.
override ENDS_LOOPS: bool = false;

// What a walk that such a device has cut short says it visited.
const CUT_SHORT: u32 = 0xffffffffu;

// Whether the device has ended a loop of this invocation early: then it ends every later one after a turn or two, this one of
// eight or nine too. (How many it has must not be known to a compiler, nor be bounded: it would unroll the loop.)
fn is_cut_short() -> bool {
    if (!ENDS_LOOPS) {
        return false;
    }
    var turns = 0u;
    loop {
        turns += 1u;
        if (turns > 7u + frame.fans[0].flip) {
            break;
        }
    }
    return turns < 8u;
}

// The pixel of a lane in a workgroup of 16 × 16: 32 lanes in a row have 8 × 4 of them, which read the same columns more often
// than 16 × 2 do.
fn pixel_of(group: vec2<u32>, lane: u32) -> vec2<u32> {
    return 16u * group + vec2((lane & 7u) | ((lane >> 2u) & 8u), ((lane >> 3u) & 3u) | ((lane >> 4u) & 12u));
}
