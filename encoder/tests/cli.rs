//! `planecast-encode` as a script sees it.

use std::path::Path;
use std::process::{Command, Output};

fn run(dir: &Path, args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_planecast-encode"))
        .current_dir(dir)
        .args(args)
        .output()
        .expect("the binary starts")
}

/// Standard output of a run that must succeed.
fn ok(dir: &Path, args: &[&str]) -> String {
    let out = run(dir, args);
    assert!(out.status.success(), "{args:?}: {}", String::from_utf8_lossy(&out.stderr));
    String::from_utf8(out.stdout).expect("output is text")
}

/// Exit status and standard error of a run that must fail.
fn fails(dir: &Path, args: &[&str]) -> (Option<i32>, String) {
    let out = run(dir, args);
    assert!(!out.status.success() && out.stdout.is_empty(), "{args:?}");
    (out.status.code(), String::from_utf8(out.stderr).expect("errors are text"))
}

#[test]
fn cli_decode_inverts_encode() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    let volume: Vec<u8> = (0..7 * 5 * 3u32).map(|i| u8::from(i * i % 7 < 3)).collect();
    std::fs::write(dir.join("a.raw"), &volume).unwrap();
    for encoding in ["solid", "surface"] {
        ok(dir, &["encode", "a.raw", "--dims", "7,5,3", "-o", "a.pcast", "--encoding", encoding]);
        ok(dir, &["decode", "a.pcast", "-o", "b.raw"]);
        assert_eq!(std::fs::read(dir.join("b.raw")).unwrap(), volume, "{encoding}");
    }
    let solid = volume[(2 * 5 + 4) * 7 + 6] == 1;
    assert_eq!(ok(dir, &["query", "a.pcast", "6", "4", "2"]), format!("{{\"solid\":{solid},\"color\":null}}\n"));
    assert_eq!(ok(dir, &["query", "a.pcast", "-6", "4", "2"]), "{\"solid\":false,\"color\":null}\n");
    let info: serde_json::Value = serde_json::from_str(&ok(dir, &["info", "a.pcast", "--json"])).unwrap();
    assert_eq!(info["dims"], serde_json::json!([7, 5, 3]));
    assert_eq!(info["solid_voxels"], volume.iter().map(|&v| u64::from(v)).sum::<u64>());
    assert!(ok(dir, &["info", "a.pcast"]).contains("\nsize      7 × 5 × 3 voxels"));
}

#[test]
fn cli_faults_of_the_input_exit_with_1_and_of_the_command_line_with_2() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    std::fs::write(dir.join("a.raw"), [1; 8]).unwrap();
    std::fs::write(dir.join("cut.pcast"), [0; 70]).unwrap();
    let (status, text) = fails(dir, &["info", "cut.pcast"]);
    assert_eq!(status, Some(1));
    assert_eq!(
        text,
        "planecast-encode: cut.pcast: not a .pcast scene (byte 0: other magic number); make one with `planecast encode`\n"
    );
    let (status, text) = fails(dir, &["decode", "none.pcast", "-o", "b.raw"]);
    assert_eq!(status, Some(1));
    assert!(text.starts_with("planecast-encode: none.pcast: cannot open: "), "{text}");
    assert!(!dir.join("b.raw").exists());
    let (status, text) = fails(dir, &["encode", "a.raw", "--dims", "2,2", "-o", "a.pcast"]);
    assert_eq!(status, Some(2));
    assert!(text.contains("a volume has three sides; expected --dims X,Y,Z"), "{text}");
    assert_eq!(fails(dir, &["encode", "procedural:terrain?size=0", "-o", "a.pcast"]).0, Some(2));
    assert_eq!(fails(dir, &["query", "a.pcast", "1", "2"]).0, Some(2));
    let (_, text) = fails(dir, &["query", "a.pcast", "1", "2", "z"]);
    assert!(text.contains("expected a whole number"), "{text}");
    assert!(!dir.join("a.pcast").exists());
}

#[test]
fn cli_specialize_leaves_out_what_is_named_and_info_tells() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    // 300 columns on a slope, one of them with a gap.
    let volume: Vec<u8> = (0..300 * 300u32).map(|i| u8::from(i / 300 < 20 + i % 300 / 2 && i != 9 + 300 * 5)).collect();
    std::fs::write(dir.join("a.raw"), &volume).unwrap();
    let encode = |how: &str| {
        ok(dir, &["encode", "a.raw", "--dims", "300,300,1", "-o", "a.pcast", "--specialize", how]);
        ok(dir, &["decode", "a.pcast", "-o", "b.raw"]);
        assert_eq!(std::fs::read(dir.join("b.raw")).unwrap(), volume, "{how}");
        let info: serde_json::Value = serde_json::from_str(&ok(dir, &["info", "a.pcast", "--json"])).unwrap();
        let left_out = info["specialization"]["left_out"].as_array().unwrap();
        let mut features: Vec<String> =
            left_out.iter().filter_map(|p| Some(p["feature"].as_str()?.to_owned())).collect();
        features.sort();
        (std::fs::read(dir.join("a.pcast")).unwrap()[8], features.join(" "))
    };
    assert_eq!(encode("off"), (1, String::new()));
    assert_eq!(encode("heights"), (3, "heights".into()));
    assert_eq!(encode("tables,lists"), (3, "lists tables".into()));
    assert_eq!(encode("auto"), (3, "heights packed tables".into()));
    let (status, text) =
        fails(dir, &["encode", "a.raw", "--dims", "300,300,1", "-o", "c.pcast", "--specialize", "hights"]);
    assert_eq!(status, Some(2));
    assert!(text.contains("\"hights\" is no feature"), "{text}");
}

#[test]
fn cli_colours_what_has_no_colours_grey_where_asked() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    std::fs::write(dir.join("a.raw"), [1, 0, 0, 1, 1, 1, 0, 0]).unwrap();
    for color in ["run", "voxel"] {
        ok(dir, &["encode", "a.raw", "--dims", "2,2,2", "-o", "a.pcast", "--color", color]);
        assert_eq!(ok(dir, &["query", "a.pcast", "1", "1", "0"]), "{\"solid\":true,\"color\":\"#808080\"}\n");
    }
}

#[test]
fn cli_writes_no_output_over_its_input() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    std::fs::create_dir(dir.join("sub")).unwrap();
    std::fs::write(dir.join("a.raw"), [1; 8]).unwrap();
    ok(dir, &["encode", "a.raw", "--dims", "2,2,2", "-o", "a.pcast"]);
    let before = std::fs::read(dir.join("a.pcast")).unwrap();
    for args in
        [&["encode", "a.raw", "--dims", "2,2,2", "-o", "sub/../a.raw"][..], &["decode", "a.pcast", "-o", "./a.pcast"]]
    {
        let (status, text) = fails(dir, args);
        assert_eq!(status, Some(2));
        assert!(text.ends_with("is the input itself; name another file to write\n"), "{text}");
    }
    assert_eq!(std::fs::read(dir.join("a.raw")).unwrap(), [1; 8]);
    assert_eq!(std::fs::read(dir.join("a.pcast")).unwrap(), before);
}
