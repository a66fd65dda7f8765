//! The comparators themselves: each planted fault must be seen and named.

mod common;

use common::compare::{compare, identical, mirrored, sane};
use common::{camera, hills, plain};
use glam::DVec3;
use planecast::Frame;

fn picture() -> Frame {
    hills([64, 64, 64]).render(&camera(DVec3::new(30.5, 50.0, 60.5), [10.0, -30.0, 0.0], [80, 60]), &plain())
}

/// The picture one pixel further to the right; the first column stands twice.
fn shifted(frame: &Frame) -> Frame {
    let w = frame.width as usize;
    let mut out = frame.clone();
    for i in (0..frame.color.len()).filter(|i| i % w > 0) {
        (out.color[i], out.depth[i], out.voxel[i]) = (frame.color[i - 1], frame.depth[i - 1], frame.voxel[i - 1]);
    }
    out
}

/// A pixel, not at the border, whose voxel is seen in that pixel alone.
fn lone_pixel(frame: &Frame) -> usize {
    let n = frame.width as usize;
    (n + 1..frame.voxel.len())
        .find(|&i| {
            i % n > 0 && frame.voxel[i][3] == 0 && frame.voxel.iter().filter(|&&v| v == frame.voxel[i]).count() == 1
        })
        .expect("a voxel that projects to one pixel")
}

#[test]
fn compare_finds_nothing_in_equal_frames() {
    let a = picture();
    let agreement = compare(&a, &a);
    assert_eq!((agreement.same, agreement.near, agreement.sky, agreement.depth), (4800, 4800, 0, 0.0));
    assert_eq!(identical(&a, &a), Ok(()));
    assert_eq!(sane(&a), Ok(()));
    assert!(a.voxel.contains(&[-1; 4]) && a.voxel.iter().any(|v| v[0] >= 0), "a picture of ground and sky");
}

#[test]
fn compare_sees_a_shift_by_one_pixel_as_near_but_not_same() {
    let a = picture();
    let agreement = compare(&shifted(&a), &a);
    assert!(agreement.same_percent() < 95.0, "{agreement}");
    assert_eq!(agreement.near, agreement.pixels, "{agreement}");
    let twice = compare(&shifted(&shifted(&a)), &a);
    assert!(twice.near_percent() < 97.0, "{twice}");
    assert!(identical(&shifted(&a), &a).unwrap_err().contains("pixels differ"));
}

#[test]
fn compare_sees_one_wrong_voxel() {
    let a = picture();
    let mut b = a.clone();
    let i = lone_pixel(&a);
    b.voxel[i][1] += 40;
    let agreement = compare(&b, &a);
    assert_eq!((agreement.same, agreement.near), (4799, 4799));
    let text = identical(&b, &a).unwrap_err();
    let place = format!("1 of 4800 pixels differ\n  pixel ({}, {}): voxel [", i % 80, i / 80);
    assert!(text.starts_with(&place), "{text}");
}

#[test]
fn compare_sees_a_wrong_level() {
    let a = picture();
    let mut b = a.clone();
    let i = lone_pixel(&a);
    b.voxel[i][3] = 1;
    let agreement = compare(&b, &a);
    assert_eq!((agreement.same, agreement.near, agreement.sky), (4799, 4799, 0));
}

#[test]
fn compare_sees_a_pixel_of_sky() {
    let a = picture();
    let mut b = a.clone();
    let i = lone_pixel(&a);
    (b.voxel[i], b.depth[i]) = ([-1; 4], f32::INFINITY);
    assert_eq!(compare(&b, &a).sky, 1);
    assert_eq!(compare(&a, &b).sky, 1);
}

#[test]
fn compare_sees_one_wrong_depth_and_names_its_pixel() {
    let a = picture();
    let i = lone_pixel(&a);
    for (fault, least) in [(a.depth[i] * 1.01, 0.0099), (f32::INFINITY, f64::INFINITY), (f32::NAN, f64::INFINITY)] {
        let mut b = a.clone();
        b.depth[i] = fault;
        let agreement = compare(&b, &a);
        assert!(agreement.depth >= least, "{agreement}");
        assert_eq!(agreement.depth_at, [i % 80, i / 80]);
    }
    let mut b = a.clone();
    b.depth[i] = f32::from_bits(a.depth[i].to_bits() ^ 1);
    assert!(identical(&b, &a).unwrap_err().contains(&format!("pixel ({}, {}): depth ", i % 80, i / 80)));
    assert!(compare(&b, &a).depth > 0.0);
}

#[test]
fn identical_sees_one_flipped_bit_of_colour_and_missing_voxels() {
    let a = picture();
    let mut b = a.clone();
    b.color[4799][3] ^= 1;
    assert!(identical(&b, &a).unwrap_err().starts_with("1 of 4800 pixels differ\n  pixel (79, 59): color ["));
    b.voxel.clear();
    assert!(identical(&b, &a).unwrap_err().starts_with("sizes: 80 × 60 with 0 voxels"));
}

#[test]
fn sane_names_what_no_frame_may_hold() {
    let a = picture();
    let i = lone_pixel(&a);
    let planted = |fault: &dyn Fn(&mut Frame)| {
        let mut b = a.clone();
        fault(&mut b);
        sane(&b).unwrap_err()
    };
    assert!(planted(&|f| f.depth[i] = f32::NAN).ends_with("depth NaN"));
    assert!(planted(&|f| f.depth[i] = -1.0).ends_with("depth -1"));
    assert!(planted(&|f| f.color[i][3] = 0).ends_with("alpha 0"));
    assert!(planted(&|f| f.voxel[i] = [-1; 4]).contains("voxel [-1, -1, -1, -1] at depth"));
    assert!(planted(&|f| f.depth[i] = f32::INFINITY).ends_with("at depth inf"));
}

#[test]
fn mirrored_twice_is_the_frame() {
    let a = picture();
    assert_eq!(identical(&mirrored(&mirrored(&a)), &a), Ok(()));
    assert!(identical(&mirrored(&a), &a).is_err());
}
