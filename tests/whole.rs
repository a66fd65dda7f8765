//! Files are whole or not there, whatever stops the command: a full disk, a signal, a folder, no permission.
#![cfg(unix)]

use std::fs;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Duration;

const PLANECAST: &str = env!("CARGO_BIN_EXE_planecast");

fn planecast(dir: &Path, line: &str) -> Command {
    let mut command = Command::new(PLANECAST);
    command.args(line.split_whitespace()).current_dir(dir).stdout(Stdio::null()).stderr(Stdio::piped());
    command
}

fn succeeds(dir: &Path, line: &str) {
    let output = planecast(dir, line).output().unwrap();
    assert!(output.status.success(), "{line}: {}", String::from_utf8_lossy(&output.stderr));
}

/// The one line that a command says that fails with status 1.
fn fails(mut command: Command) -> String {
    let output = command.output().unwrap();
    let text = String::from_utf8(output.stderr).unwrap();
    let said: Vec<&str> = text.lines().filter(|l| !l.starts_with("drawing on")).collect();
    assert_eq!(output.status.code(), Some(1), "{text}");
    assert!(
        (1..=2).contains(&said.len()) && said[0].starts_with("planecast: ") && !text.contains("panicked"),
        "{text}"
    );
    said.join("\n")
}

/// Names in a folder, sorted; passing names of planecast's own left out where a kill may leave them.
fn names(dir: &Path) -> Vec<String> {
    let mut names: Vec<String> =
        fs::read_dir(dir).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

/// A folder with a small scene.
fn workplace() -> tempfile::TempDir {
    let dir = tempfile::tempdir().unwrap();
    succeeds(dir.path(), "encode procedural:rocks?size=64 -o a.pcast");
    dir
}

/// The same command where files may have 4 KiB: the kernel refuses a write in its midst, as on a full disk.
fn on_a_full_disk(dir: &Path, line: &str) -> Command {
    let mut command = Command::new("sh");
    command.arg("-c").arg(format!("trap '' XFSZ; ulimit -f 8; exec {PLANECAST} {line}"));
    command.current_dir(dir).stdout(Stdio::null()).stderr(Stdio::piped());
    command
}

#[test]
fn full_disk_leaves_the_old_file_and_nothing_else() {
    let dir = workplace();
    succeeds(dir.path(), "render a.pcast -o a.png --size 20x10 --device cpu");
    let old = [fs::read(dir.path().join("a.png")).unwrap(), fs::read(dir.path().join("a.pcast")).unwrap()];
    for line in [
        "encode procedural:rocks?size=64\\&seed=3 -o a.pcast",
        "encode procedural:rocks?size=64 -o new.pcast",
        "decode a.pcast -o volume.raw",
        "render a.pcast -o a.png --size 400x300 --device cpu",
        "render a.pcast -o new.png --size 40x30 --device cpu --depth d.npy --voxel v.npy",
    ] {
        let said = fails(on_a_full_disk(dir.path(), line));
        assert!(said.contains("cannot write"), "{line}: {said}");
        assert_eq!(names(dir.path()), ["a.pcast", "a.png"], "{line}");
        assert!(old == [fs::read(dir.path().join("a.png")).unwrap(), fs::read(dir.path().join("a.pcast")).unwrap()]);
    }
}

#[test]
fn folders_and_files_without_permission_are_plain_errors() {
    let dir = workplace();
    fs::create_dir(dir.path().join("folder")).unwrap();
    for line in [
        "render a.pcast -o folder --size 8x8 --device cpu",
        "render folder -o a.png --size 8x8 --device cpu",
        "encode folder -o b.pcast",
        "encode procedural:shapes?size=8 -o folder",
        "decode folder -o b.raw",
        "info folder",
        "query folder 1 2 3",
    ] {
        let said = fails(planecast(dir.path(), line));
        assert!(said.contains("folder"), "{line}: {said}");
    }
    use std::os::unix::fs::PermissionsExt;
    fs::set_permissions(dir.path().join("a.pcast"), fs::Permissions::from_mode(0o000)).unwrap();
    // Root may read everything.
    if fs::File::open(dir.path().join("a.pcast")).is_err() {
        let said = fails(planecast(dir.path(), "info a.pcast"));
        assert!(said.contains("cannot open"), "{said}");
    }
    assert_eq!(names(dir.path()), ["a.pcast", "folder"]);
}

#[test]
fn scenes_cut_short_or_changed_are_refused() {
    let dir = workplace();
    let whole = fs::read(dir.path().join("a.pcast")).unwrap();
    for len in [0, 1, 63, 64, 65, whole.len() / 2, whole.len() - 1] {
        fs::write(dir.path().join("b.pcast"), &whole[..len]).unwrap();
        let said = fails(planecast(dir.path(), "render b.pcast -o b.png --size 8x8 --device cpu"));
        assert!(said.contains("b.pcast"), "{said}");
    }
    for at in (64..whole.len()).step_by(whole.len() / 23) {
        let mut bytes = whole.clone();
        bytes[at] ^= 0x40;
        fs::write(dir.path().join("b.pcast"), &bytes).unwrap();
        // Padding between blobs is the only byte that nothing rests on.
        let output = planecast(dir.path(), "decode b.pcast -o b.raw").output().unwrap();
        if output.status.success() {
            succeeds(dir.path(), "decode a.pcast -o a.raw");
            assert!(fs::read(dir.path().join("a.raw")).unwrap() == fs::read(dir.path().join("b.raw")).unwrap());
        }
        let _ = fs::remove_file(dir.path().join("b.raw"));
    }
}

/// A scene replaced while it is open, as planecast itself replaces files, goes on to be read as it was.
#[test]
fn a_scene_replaced_under_its_reader_stays_what_it_was() {
    let dir = workplace();
    let path = dir.path().join("a.pcast");
    let file = planecast_encoder::PcastFile::open(&path).unwrap();
    let before = file.read_scene().unwrap();
    succeeds(dir.path(), "encode procedural:shapes?size=24 -o a.pcast");
    assert!(file.read_scene().unwrap() == before);
    let after = planecast_encoder::PcastFile::open(&path).unwrap().read_scene().unwrap();
    assert!(after != before);
}

/// Ctrl-C after any time: the old file or the whole new one, and a folder that a next run can use.
#[test]
fn interrupts_leave_whole_files() {
    let dir = workplace();
    let path = |name: &str| dir.path().join(name);
    let mut interrupted = 0;
    for (line, name) in [
        ("encode procedural:rocks?size=96 -o b.pcast", "b.pcast"),
        ("render a.pcast -o b.png --size 600x500 --device cpu", "b.png"),
        ("render a.pcast -o b.png --size 600x500 --device exact", "b.png"),
    ] {
        // The first run may wait for the disk.
        let time = |_| {
            let at = std::time::Instant::now();
            succeeds(dir.path(), line);
            at.elapsed()
        };
        let takes = (0..3).map(time).min().unwrap();
        let old = fs::read(path(name)).unwrap();
        for k in 0..20 {
            let mut child = planecast(dir.path(), line).spawn().unwrap();
            std::thread::sleep(takes * k / 20);
            let killed = Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap().success();
            let status = child.wait().unwrap();
            interrupted += u32::from(killed && !status.success());
            assert!(fs::read(path(name)).unwrap() == old, "{line} after {k} twentieths");
            let left = names(dir.path()).into_iter().filter(|n| !n.starts_with(".planecast-")).count();
            assert!(left <= 3, "{:?}", names(dir.path()));
        }
    }
    // More than those that had not begun.
    assert!(interrupted > 3, "{interrupted} runs were interrupted");
    // A film: what is there is whole frames, and the rest can follow.
    let film = "fly a.pcast -o film --tour --frames 30 --size 160x120 --device cpu";
    for k in 0..6 {
        let mut child = planecast(dir.path(), film).spawn().unwrap();
        std::thread::sleep(Duration::from_millis(150 * k));
        let _ = Command::new("kill").args(["-INT", &child.id().to_string()]).status();
        child.wait().unwrap();
        let Ok(frames) = fs::read_dir(path("film")) else { continue };
        for frame in frames.map(|f| f.unwrap().path()).filter(|f| f.extension().is_some_and(|e| e == "png")) {
            assert_eq!(image::open(&frame).unwrap().width(), 160, "{}", frame.display());
        }
        fs::remove_dir_all(path("film")).unwrap();
    }
}
