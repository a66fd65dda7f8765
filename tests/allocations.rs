//! What a loop of frames asks of the allocator: whatever is larger than a few words of its figures only once.

use std::alloc::{GlobalAlloc, Layout, System};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use glam::DVec3;
use planecast::render::device::{Device, Renderer};
use planecast::{Camera, Options, Outputs, Resident};
use planecast_encoder::source::procedural::{Kind, procedural};
use planecast_encoder::{BuildOptions, build};

/// Counts what is asked for at once from this size on: more than names in [`planecast::Stats`] take, and what rayon hands tasks
/// over in, less than a row of pixels or the planes of a picture.
const LARGE: usize = 2 << 10;

static LARGE_ONES: AtomicUsize = AtomicUsize::new(0);

struct Counting;

// SAFETY: all is passed on to the system's allocator.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        if layout.size() >= LARGE {
            LARGE_ONES.fetch_add(1, Ordering::Relaxed);
        }
        // SAFETY: as for this function.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, memory: *mut u8, layout: Layout) {
        // SAFETY: as for this function.
        unsafe { System.dealloc(memory, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

#[test]
fn frames_in_a_loop_take_the_memory_of_those_before() {
    let scene = Arc::new(build(procedural(Kind::Rocks, 64, 7).unwrap(), &BuildOptions::default()).unwrap());
    let resident = Arc::new(Resident::new(&scene));
    let camera = |i: usize| Camera {
        eye: DVec3::new(20.3 + i as f64, 70.7, 31.4),
        yaw: 30.0 + i as f64,
        pitch: -20.0,
        roll: 0.0,
        fov: 60.0,
        width: 640,
        height: 360,
    };
    let mut tell = |text: &str| panic!("{text}");
    for kernel in ["planes", "raycast"] {
        let mut renderer = Renderer::with_kernel(&scene, &resident, Device::Cpu, Some(kernel), &mut tell).unwrap();
        let mut draw = |i: usize, given_back: bool| {
            let before = LARGE_ONES.load(Ordering::Relaxed);
            let frame = renderer.draw_with(&camera(i), &Options::default(), Outputs::default(), &mut tell).unwrap();
            let asked = LARGE_ONES.load(Ordering::Relaxed) - before;
            if given_back {
                renderer.reuse(Some(frame));
            }
            asked
        };
        let first = draw(0, true);
        assert!(first >= 4, "{kernel}: the first frame takes its memory: {first}");
        // Poses differ in how many samples they have, and threads in what they draw of them: what one more needs may be asked
        // for once.
        (1..40).for_each(|i| _ = draw(i % 20, true));
        let later: usize = (0..20).map(|i| draw(i, true)).sum();
        draw(3, false);
        let without = draw(4, true);
        assert_eq!((later, without), (0, 2), "{kernel}: a frame that is kept takes colours and depths with it");
    }
}
