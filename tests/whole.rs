//! Files are whole or not there, whatever stops the command: a full disk, a signal, a folder, no permission, a file that is
//! cut short or changed while it is read, a header that claims more than there can be.
#![cfg(unix)]

use planecast_encoder::format::Header;
use std::fs;
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
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
    assert_eq!(names(dir.path()), ["a.pcast", "folder"]);
}

#[test]
fn what_may_not_be_read_or_written_is_a_plain_error() {
    use std::os::unix::fs::{MetadataExt, PermissionsExt};
    use std::os::unix::process::CommandExt;
    let dir = workplace();
    let path = |name: &str| dir.path().join(name);
    let mode = |name: &str, mode| fs::set_permissions(path(name), fs::Permissions::from_mode(mode)).unwrap();
    // Root may do everything: then as a user who may not, from a place that is open to all.
    let is_root = fs::metadata(path("a.pcast")).unwrap().uid() == 0;
    let program = path("program");
    fs::copy(PLANECAST, &program).unwrap();
    let command = |line: &str| {
        let mut command = Command::new(&program);
        command.args(line.split_whitespace()).current_dir(dir.path()).stdout(Stdio::null()).stderr(Stdio::piped());
        if is_root {
            command.uid(65_534).gid(65_534);
        }
        command
    };
    mode("", 0o755);
    fs::copy(path("a.pcast"), path("closed.pcast")).unwrap();
    mode("closed.pcast", 0o000);
    fs::create_dir(path("locked")).unwrap();
    fs::create_dir(path("open")).unwrap();
    mode("open", 0o777);
    mode("locked", 0o555);
    mode("a.pcast", 0o644);
    assert!(command("info a.pcast").output().unwrap().status.success());
    for line in [
        "info closed.pcast",
        "render closed.pcast -o open/b.png --size 8x8 --device cpu",
        "encode closed.pcast -o open/b.pcast",
    ] {
        let said = fails(command(line));
        assert!(said.contains("closed.pcast") && said.contains("cannot open"), "{line}: {said}");
    }
    for line in [
        "render a.pcast -o locked/b.png --size 8x8 --device cpu",
        "encode procedural:shapes?size=8 -o locked/b.pcast",
        "decode a.pcast -o locked/b.raw",
    ] {
        let said = fails(command(line));
        assert!(said.contains("locked") && said.contains("ermission denied"), "{line}: {said}");
    }
    assert_eq!([names(&path("locked")), names(&path("open"))], [const { Vec::<String>::new() }; 2]);
    assert_eq!(names(dir.path()), ["a.pcast", "closed.pcast", "locked", "open", "program"]);
    mode("locked", 0o755);
}

/// A volume and a scene cut short while a command reads them, at all times of its run: the whole result or one plain line,
/// and the old file where there was one.
#[test]
fn files_cut_short_while_they_are_read_are_plain_errors() {
    let dir = tempfile::tempdir().unwrap();
    let path = |name: &str| dir.path().join(name);
    let n = 288usize;
    let volume: Vec<u8> = (0..n * n * n).map(|i| u8::from((i / 3 % 7 + i / n % 5).is_multiple_of(3))).collect();
    fs::write(path("whole.raw"), &volume).unwrap();
    succeeds(dir.path(), &format!("encode whole.raw --dims {n},{n},{n} -o whole.pcast"));
    let mut cut = Vec::new();
    for (input, line, output) in [
        ("raw", format!("encode in.raw --dims {n},{n},{n} -o out.pcast"), "out.pcast"),
        ("pcast", "decode in.pcast -o out.raw".to_string(), "out.raw"),
        ("pcast", "render in.pcast -o out.png --size 8x8 --device cpu".to_string(), "out.png"),
    ] {
        let (whole, name) = (path(&format!("whole.{input}")), path(&format!("in.{input}")));
        fs::copy(&whole, &name).unwrap();
        let begun = std::time::Instant::now();
        succeeds(dir.path(), &line);
        let takes = begun.elapsed();
        let old = fs::read(path(output)).unwrap();
        for k in 0..16 {
            fs::copy(&whole, &name).unwrap();
            let child = planecast(dir.path(), &line).spawn().unwrap();
            std::thread::sleep(takes * k / 16);
            fs::File::options().write(true).open(&name).unwrap().set_len(k as u64 * 100).unwrap();
            let done = child.wait_with_output().unwrap();
            let text = String::from_utf8(done.stderr).unwrap();
            assert!(fs::read(path(output)).unwrap() == old, "{line} after {k} sixteenths");
            if !done.status.success() {
                let said: Vec<&str> = text.lines().filter(|l| l.starts_with("planecast: ")).collect();
                assert!(done.status.code() == Some(1) && said.len() == 1, "{line}: {:?} {text}", done.status);
                assert!(said[0].contains(&format!("in.{input}")) && !text.contains("fault in the program"), "{text}");
                cut.push(said[0].to_string());
            }
            let passing = names(dir.path()).into_iter().filter(|n| n.starts_with(".planecast-")).count();
            assert_eq!(passing, 0, "{line}: {:?}", names(dir.path()));
        }
    }
    let meanwhile = cut.iter().filter(|said| said.contains(": the file was cut short while it was read")).count();
    println!("{} runs failed, {meanwhile} in their midst, as in {:?}", cut.len(), cut.last());
    assert!(meanwhile >= 3, "{cut:?}");
}

/// A file cut short that all threads read at the same time: told once, by whichever came first.
#[test]
fn a_file_that_many_threads_miss_is_told_of_once() {
    const THREADS: usize = 8;
    const PAGES: usize = 64;
    if let Some(path) = std::env::var_os("PLANECAST_TEST_CUT") {
        // The program that ends: every thread in a page of its own that is gone.
        planecast_encoder::store::guard::explain_lost_files();
        let file = fs::File::options().read(true).write(true).open(&path).unwrap();
        let map = planecast_encoder::store::guard::Map::new(Path::new(&path), &file).unwrap();
        file.set_len(0).unwrap();
        let start = std::sync::Barrier::new(THREADS);
        std::thread::scope(|scope| {
            for k in 0..THREADS {
                let (map, start) = (&map, &start);
                scope.spawn(move || {
                    start.wait();
                    std::hint::black_box(map[k * PAGES / THREADS * 4096]);
                });
            }
        });
        unreachable!("the file's bytes are gone");
    }
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("cut");
    for _ in 0..20 {
        fs::write(&path, vec![1; PAGES * 4096]).unwrap();
        let output = Command::new(std::env::current_exe().unwrap())
            .args(["--exact", "a_file_that_many_threads_miss_is_told_of_once", "--nocapture"])
            .env("PLANECAST_TEST_CUT", &path)
            .output()
            .unwrap();
        let text = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(1), "{text}");
        assert!(text.lines().count() == 1 && text.matches("planecast: ").count() == 1, "{text}");
        assert!(text.contains("cut: byte ") && text.contains(": the file was cut short while it was read"), "{text}");
    }
}

/// Sets its flag when it goes, where a test fails too: a thread that looks for it would go on for ever.
struct Done<'a>(&'a AtomicBool);

impl Drop for Done<'_> {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

/// A scene whose bytes change in place while they are read: read or refused, and nothing else.
#[test]
fn scenes_changed_in_place_while_they_are_read_are_read_or_refused() {
    use std::os::unix::fs::FileExt;
    let dir = workplace();
    let path = dir.path().join("a.pcast");
    let whole = fs::read(&path).unwrap();
    let file = planecast_encoder::PcastFile::open(&path).unwrap();
    let right = file.read_scene().unwrap();
    let done = AtomicBool::new(false);
    let (mut read, mut refused) = (0, 0);
    std::thread::scope(|scope| {
        scope.spawn(|| {
            let out = fs::File::options().write(true).open(&path).unwrap();
            let mut state = 1u64;
            while !done.load(Ordering::Relaxed) {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                let at = (state >> 33) % whole.len() as u64;
                let old = whole[at as usize];
                out.write_all_at(&[old ^ (1 << (state >> 60 & 7))], at).unwrap();
                out.write_all_at(&[old], at).unwrap();
            }
        });
        let _done = Done(&done);
        for _ in 0..400 {
            match file.read_scene() {
                Ok(scene) => {
                    read += 1;
                    // Of 64-bit checksums, and of bytes that nothing rests on.
                    assert!(scene.dims() == right.dims());
                }
                Err(e) => {
                    refused += 1;
                    assert!(e.to_string().contains("a.pcast"), "{e}");
                }
            }
        }
    });
    println!("{read} read, {refused} refused");
    assert!(read > 0 && refused > 0, "{read} read, {refused} refused");
}

/// Headers of a few bytes that claim some 2⁶⁰ voxels, points or bytes, where a program may have 3 GB of addresses.
#[test]
fn headers_that_claim_too_much_are_refused_before_memory_is_asked_for() {
    let dir = tempfile::tempdir().unwrap();
    let write = |name: &str, bytes: Vec<u8>| fs::write(dir.path().join(name), bytes).unwrap();
    let side = 1u64 << 20;
    write("a.raw", vec![1; 64]);
    let dict = format!("{{'descr': '|u1', 'fortran_order': False, 'shape': ({side}, {side}, {side}), }}\n");
    write(
        "a.npy",
        [b"\x93NUMPY\x01\0".as_slice(), &(dict.len() as u16).to_le_bytes(), dict.as_bytes(), &[0; 64]].concat(),
    );
    let nrrd = format!("NRRD0004\ntype: uint8\ndimension: 3\nsizes: {side} {side} {side}\nencoding: raw\n\nabcd");
    write("a.nrrd", nrrd.into_bytes());
    let mut nifti = vec![0u8; 400];
    nifti[..4].copy_from_slice(&348u32.to_le_bytes());
    [4i16, 32_767, 32_767, 32_767, 32_767].iter().enumerate().for_each(|(k, n)| {
        nifti[40 + 2 * k..42 + 2 * k].copy_from_slice(&n.to_le_bytes());
    });
    nifti[70..72].copy_from_slice(&2i16.to_le_bytes());
    nifti[72..74].copy_from_slice(&8i16.to_le_bytes());
    nifti[108..112].copy_from_slice(&352f32.to_le_bytes());
    nifti[344..348].copy_from_slice(b"n+1\0");
    write("a.nii", nifti);
    let ply = |what: &str| format!("ply\nformat binary_little_endian 1.0\n{what}end_header\nabcd").into_bytes();
    let vertices = "property float x\nproperty float y\nproperty float z\n";
    write("a.ply", ply(&format!("element vertex {}\n{vertices}", 1u64 << 60)));
    let faces = format!("element face {}\nproperty list uchar int vertex_indices\n", 1u64 << 60);
    write("b.ply", ply(&format!("element vertex 1\n{vertices}{faces}")));
    write("a.stl", [vec![b' '; 80], u32::MAX.to_le_bytes().to_vec(), vec![0; 50]].concat());
    let mut png = b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR\x7f\xff\xff\xff\x7f\xff\xff\xff\x10\0\0\0\0".to_vec();
    let mut crc = flate2::Crc::new();
    crc.update(&png[12..]);
    png.extend(crc.sum().to_be_bytes());
    png.extend(b"\0\0\0\0IDAT\x35\xaf\x06\x1e\0\0\0\0IEND\xae\x42\x60\x82");
    write("a.png", png);
    let mut vox = b"VOX \x96\0\0\0MAIN\0\0\0\0\x2c\0\0\0SIZE\x0c\0\0\0\0\0\0\0".to_vec();
    [[0xff, 0xff, 0xff, 0x7f]; 3].iter().for_each(|n| vox.extend(n));
    vox.extend(b"XYZI\x08\0\0\0\0\0\0\0\xff\xff\xff\x7f\0\0\0\0");
    write("a.vox", vox);
    let gltf = format!(
        "{{\"asset\":{{\"version\":\"2.0\"}},\"buffers\":[{{\"byteLength\":{0}}}],\"bufferViews\":[{{\"buffer\":0,\
         \"byteLength\":{0}}}],\"accessors\":[{{\"bufferView\":0,\"componentType\":5126,\"count\":{1},\"type\":\"VEC3\",\"min\":[0,0,0],\"max\":[1,1,1]}}],\
         \"meshes\":[{{\"primitives\":[{{\"attributes\":{{\"POSITION\":0}}}}]}}],\"nodes\":[{{\"mesh\":0}}],\
         \"scenes\":[{{\"nodes\":[0]}}],\"scene\":0}}",
        1u64 << 60,
        (1u64 << 60) / 12
    );
    write("a.gltf", gltf.into_bytes());
    for line in [
        "encode a.raw --dims 1048576,1048576,1048576 -o out.pcast",
        "encode a.npy -o out.pcast",
        "encode a.nrrd -o out.pcast",
        "encode a.nii -o out.pcast",
        "encode a.ply -o out.pcast",
        "encode b.ply -o out.pcast",
        "encode a.stl -o out.pcast",
        "encode a.png -o out.pcast",
        "encode a.vox -o out.pcast",
        "encode a.gltf -o out.pcast",
    ] {
        let mut command = Command::new("sh");
        command.arg("-c").arg(format!("ulimit -v 3000000; ulimit -t 20; exec {PLANECAST} {line} --threads 2"));
        command.current_dir(dir.path()).stdout(Stdio::null()).stderr(Stdio::piped());
        let said = fails(command);
        println!("{line}: {said}");
        assert!(said.contains(line.split(' ').nth(1).unwrap()), "{line}: {said}");
        assert!(!dir.path().join("out.pcast").exists());
    }
    // A scene of many columns, its header's checksum right: the file is too short for them.
    let mut scene = fs::read(workplace().path().join("a.pcast")).unwrap();
    let at = ..size_of::<Header>();
    let mut header: Header = bytemuck::pod_read_unaligned(&scene[at]);
    header.dims = [1 << 30, 65_536, 1 << 30];
    header.checksum = header.checksum();
    scene[at].copy_from_slice(bytemuck::bytes_of(&header));
    write("a.pcast", scene);
    for line in ["info a.pcast", "decode a.pcast -o out.raw", "render a.pcast -o out.png --device cpu"] {
        let mut command = Command::new("sh");
        command.arg("-c").arg(format!("ulimit -v 3000000; ulimit -t 20; exec {PLANECAST} {line}"));
        command.current_dir(dir.path()).stdout(Stdio::null()).stderr(Stdio::piped());
        let said = fails(command);
        println!("{line}: {said}");
        assert!(said.contains("a.pcast") && !said.contains("checksum"), "{line}: {said}");
    }
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
    let (mut interrupted, mut told, mut passing) = (0, 0, 0);
    for (line, name) in [
        ("encode procedural:rocks?size=96 -o b.pcast", "b.pcast"),
        ("decode a.pcast -o b.raw", "b.raw"),
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
        let (old, before) = (fs::read(path(name)).unwrap(), names(dir.path()));
        for k in 0..20 {
            let child = planecast(dir.path(), line).spawn().unwrap();
            std::thread::sleep(takes * k / 20);
            let killed = Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap().success();
            let done = child.wait_with_output().unwrap();
            let said = String::from_utf8(done.stderr).unwrap();
            interrupted += u32::from(killed && !done.status.success());
            if done.status.code().is_some_and(|code| code != 0) {
                assert!(done.status.code() == Some(1) && said.contains("planecast: interrupted; "), "{line}: {said}");
                told += 1;
            }
            assert!(fs::read(path(name)).unwrap() == old, "{line} after {k} twentieths");
            let (left, others): (Vec<_>, Vec<_>) =
                names(dir.path()).into_iter().partition(|n| n.starts_with(".planecast-"));
            // What an interrupted encode may leave beside the old file, for `--resume`.
            let log = |other: &String| line.starts_with("encode") && *other == format!(".{name}.unfinished");
            let strange: Vec<_> = others.iter().filter(|other| !before.contains(other) && !log(other)).collect();
            assert!(strange.is_empty(), "{line} after {k} twentieths left {strange:?}");
            passing += left.len();
            left.iter().for_each(|name| fs::remove_file(path(name)).unwrap());
        }
        succeeds(dir.path(), line);
        assert_eq!(names(dir.path()), before, "after {line} went on to its end");
    }
    // More than those that had not begun.
    assert!(interrupted > 3 && told > 0, "{interrupted} runs were interrupted, {told} said so");
    // Between the removal of passing files and a program's end there is a moment in which one can be made.
    assert!(passing <= 1, "{passing} passing files were left");
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
