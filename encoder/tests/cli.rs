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
    assert!(ok(dir, &["info", "a.pcast"]).starts_with("world     7 × 5 × 3 voxels"));
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
    let colors = ["encode", "a.raw", "--dims", "2,2,2", "-o", "a.pcast", "--color", "voxel"];
    let (status, text) = fails(dir, &colors);
    assert_eq!(status, Some(2));
    assert_eq!(text, "planecast-encode: the input has no colours, but --color voxel asks for them\n");
    assert_eq!(fails(dir, &["query", "a.pcast", "1", "2"]).0, Some(2));
    assert!(!dir.join("a.pcast").exists());
}
