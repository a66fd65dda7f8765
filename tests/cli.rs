//! The `planecast` command from outside: what it writes, says and returns.

use std::fs;
use std::io::Read;
use std::path::Path;
use std::process::{Command, Output, Stdio};

use planecast_encoder::format::write::write_scene;
use planecast_encoder::{BuildOptions, Colors, ColumnsBuilder, Input, Run, build};

/// A folder with `hills.pcast`, a coloured 48 × 20 × 40 terrain.
fn workplace() -> tempfile::TempDir {
    let dir = tempfile::tempdir().unwrap();
    let mut columns = ColumnsBuilder::new(48, 20, 40);
    let mut colors = Vec::new();
    for z in 0..40u16 {
        for x in 0..48u16 {
            columns.push_run(Run::new(0, 2 + (x * 7 + z * 3) % 11));
            columns.end_column();
            colors.push([x as u8 * 5, 128, z as u8 * 6]);
        }
    }
    let input = Input { columns: columns.finish(), colors: Colors::Column(colors), notes: Vec::new() };
    let scene = build(input, &BuildOptions::default()).unwrap();
    write_scene(&scene, &dir.path().join("hills.pcast")).unwrap();
    dir
}

fn planecast(dir: &Path, line: &str) -> Output {
    Command::new(env!("CARGO_BIN_EXE_planecast")).args(line.split_whitespace()).current_dir(dir).output().unwrap()
}

/// Runs a command that must fail: its exit status and the one line it says.
fn fails(dir: &Path, line: &str) -> (i32, String) {
    let output = planecast(dir, line);
    let text = String::from_utf8(output.stderr).unwrap();
    let said: Vec<&str> = text.lines().filter(|l| !l.starts_with("drawing on")).collect();
    assert!(output.stdout.is_empty() && said.len() == 1 && said[0].starts_with("planecast: "), "{line}: {text}");
    (output.status.code().unwrap(), said[0]["planecast: ".len()..].to_string())
}

fn succeeds(dir: &Path, line: &str) -> String {
    let output = planecast(dir, line);
    assert!(output.status.success(), "{line}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

fn names(dir: &Path) -> Vec<String> {
    let mut names: Vec<String> =
        fs::read_dir(dir).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

#[test]
fn render_writes_all_that_is_asked_for() {
    let dir = workplace();
    succeeds(
        dir.path(),
        "render hills.pcast -o p.png --eye -5,30,-2 --yaw 140 --pitch -40 --size 40x30 --device cpu \
         --depth d.npy --voxel v.npy --stats s.json",
    );
    assert_eq!(names(dir.path()), ["d.npy", "hills.pcast", "p.png", "s.json", "v.npy"]);
    assert_eq!(image::open(dir.path().join("p.png")).unwrap().into_rgb8().dimensions(), (40, 30));
    assert_eq!(fs::metadata(dir.path().join("v.npy")).unwrap().len(), 128 + 40 * 30 * 16);
    let stats: serde_json::Value = serde_json::from_slice(&fs::read(dir.path().join("s.json")).unwrap()).unwrap();
    for key in [
        "device",
        "kernel",
        "planes",
        "levels",
        "width",
        "height",
        "cpu_ms",
        "columns_visited",
        "runs_visited",
        "spans_drawn",
        "bytes_scene_gpu",
        "specialization",
    ] {
        assert!(stats.get(key).is_some(), "{key}: {stats}");
    }
    for stage in ["setup", "traverse", "remap", "shade", "total"] {
        assert!(stats["cpu_ms"][stage].is_number(), "{stage}");
    }
}

#[test]
fn render_without_a_pose_shows_the_scene() {
    let dir = workplace();
    succeeds(dir.path(), "render hills.pcast -o p.png --size 64x48 --device exact --depth d.npy");
    let depth = fs::read(dir.path().join("d.npy")).unwrap();
    let shown = depth[128..].chunks(4).filter(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]]).is_finite()).count();
    assert!(shown > 64 * 48 / 4, "{shown}");
}

#[test]
fn render_leaves_nothing_if_one_output_cannot_be_written() {
    let dir = workplace();
    let (status, said) = fails(dir.path(), "render hills.pcast -o p.png --size 8x8 --stats no/s.json");
    assert_eq!((status, said.as_str()), (1, "no/s.json: the folder no does not exist; create it first"));
    assert_eq!(names(dir.path()), ["hills.pcast"]);
}

#[test]
fn exit_status_tells_the_command_line_from_the_input() {
    let dir = workplace();
    fs::write(dir.path().join("bad.pcast"), [7; 100]).unwrap();
    fs::write(dir.path().join("p.json"), r#"[{"t":0,"eye":[1,2,3],"yaw":0,"pitch":95}]"#).unwrap();
    fs::write(dir.path().join("far.json"), r#"[{"t":0,"eye":[1e99,2,3],"yaw":0,"pitch":9}]"#).unwrap();
    for (status, line) in [
        (2, "render hills.pcast -o p.png --pitch 95"),
        (2, "render hills.pcast -o p.png --eye --yaw 3"),
        (2, "render hills.pcast"),
        (2, "nosuch"),
        (2, "render hills.pcast -o hills.pcast"),
        (2, "render hills.pcast -o p.png --voxel ./p.png"),
        (2, "fly hills.pcast -o film --path p.json --save-path p.json"),
        (2, "fly hills.pcast -o film.webm"),
        (2, "fly hills.pcast -o film --encoder h264"),
        (2, "fly hills.pcast -o film.gif --fps 60"),
        (2, "fly hills.pcast -o film --frames 9..3"),
        (2, "fly hills.pcast -o film --frames 2..9/8"),
        (1, "join hills.pcast -o film.mp4"),
        (2, "render hills.pcast -o p.png --kernel nosuch --device cpu"),
        (2, "pick hills.pcast --from 1,2,3 --dir 0,0,0"),
        (1, "render nosuch.pcast -o p.png"),
        (1, "render bad.pcast -o p.png"),
        (1, "render hills.pcast -o ."),
        (1, "fly hills.pcast -o film --path p.json"),
        (1, "fly hills.pcast -o film --path far.json --size 8x8 --device cpu"),
        (1, "fly hills.pcast -o no/film.mp4"),
    ] {
        assert_eq!(fails(dir.path(), line).0, status, "{line}");
    }
    let (_, said) = fails(dir.path(), "fly hills.pcast -o film --path p.json");
    assert_eq!(said, "p.json: keyframe 1, pitch: 95 is not in -90 to 90");
    let (_, said) = fails(dir.path(), "fly hills.pcast -o film --path far.json --size 8x8 --device cpu");
    assert_eq!(said, "far.json: eye x = 1e99: must be within ±1.073741824e9 voxels");
}

#[test]
fn auto_says_nothing_but_which_device_draws_and_what_is_made() {
    let dir = workplace();
    let mut command = Command::new(env!("CARGO_BIN_EXE_planecast"));
    command.args(["render", "hills.pcast", "-o", "p.png", "--size", "8x8"]).current_dir(dir.path());
    for name in ["DISPLAY", "WAYLAND_DISPLAY", "XDG_RUNTIME_DIR", "NODEVICE_SELECT"] {
        command.env_remove(name);
    }
    let output = command.output().unwrap();
    let said = String::from_utf8(output.stderr).unwrap();
    let said: Vec<&str> = said.lines().collect();
    assert!(output.status.success() && said.len() == 2 && said[0].starts_with("drawing on the "), "{said:?}");
    assert!(said[1].starts_with("p.png: "), "{said:?}");
}

#[test]
fn info_tells_of_a_world_of_sheets() {
    let dir = workplace();
    succeeds(dir.path(), "encode procedural:rocks?size=256&seed=3 -o a.pcast -q");
    succeeds(dir.path(), "world a.pcast a.pcast -o w.pworld");
    let said = succeeds(dir.path(), "info w.pworld");
    assert!(said.contains("world of sheets") && said.contains("512 × 128 × 256 voxels"), "{said}");
    let json: serde_json::Value = serde_json::from_str(&succeeds(dir.path(), "info w.pworld --json")).unwrap();
    assert_eq!(json["dims"], serde_json::json!([512, 128, 256]), "{json}");
}

#[test]
fn pick_prints_one_json_object() {
    let dir = workplace();
    assert_eq!(
        succeeds(dir.path(), "pick hills.pcast --from 3.5,30,0.5 --dir 0,-2,0"),
        "{\"hit\":true,\"voxel\":[3,12,0],\"distance\":17.0,\"face\":\"+y\",\"color\":\"#0f8000\"}\n"
    );
    assert!(succeeds(dir.path(), "pick hills.pcast --from -3.5,30,0.5 --dir -1,0,0").starts_with("{\"hit\":false,"));
}

#[test]
fn fly_saves_a_path_that_it_flies_again() {
    let dir = workplace();
    succeeds(dir.path(), "fly hills.pcast -o a --frames 3 --size 32x20 --device cpu --save-path p.json");
    succeeds(dir.path(), "fly hills.pcast -o b --frames 3 --size 32x20 --device cpu --path p.json");
    assert_eq!(names(&dir.path().join("a")), ["000000.png", "000001.png", "000002.png", "fly.json"]);
    for frame in ["000000.png", "000002.png"] {
        assert_eq!(
            fs::read(dir.path().join("a").join(frame)).unwrap(),
            fs::read(dir.path().join("b").join(frame)).unwrap()
        );
    }
    assert_eq!(fails(dir.path(), "fly hills.pcast -o a --frames 3 --size 32x20").0, 1, "frames are not written over");
    succeeds(dir.path(), "fly hills.pcast -o a --frames 3 --size 32x20 --device cpu --resume");
}

#[test]
fn output_to_a_closed_pipe_is_no_error() {
    let dir = workplace();
    for line in ["pick hills.pcast --from 1,30,1 --dir 0,-1,0", "--help"] {
        let mut child = Command::new(env!("CARGO_BIN_EXE_planecast"))
            .args(line.split_whitespace())
            .current_dir(dir.path())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        drop(child.stdout.take());
        let mut said = String::new();
        child.stderr.take().unwrap().read_to_string(&mut said).unwrap();
        assert!(child.wait().unwrap().success() && said.is_empty(), "{line}: {said}");
    }
}

#[cfg(all(unix, any(feature = "h264", feature = "av1")))]
#[test]
fn fly_interrupted_leaves_a_film_and_goes_on() {
    let dir = workplace();
    let line = "fly hills.pcast -o film.mp4 --frames 1500 --size 64x36 --device cpu";
    let mut child = Command::new(env!("CARGO_BIN_EXE_planecast"))
        .args(line.split_whitespace())
        .current_dir(dir.path())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    // The first segment is there: in the middle of the film.
    while !dir.path().join("film.mp4.parts/000000.segment").exists() {
        assert!(child.try_wait().unwrap().is_none(), "the film ended too soon");
        std::thread::sleep(std::time::Duration::from_millis(2));
    }
    assert!(Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap().success());
    let output = child.wait_with_output().unwrap();
    let said = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(1), "{said}");
    assert!(said.contains("of 1500 frames in film.mp4; the same command with --resume goes on"), "{said}");
    let film = || fs::read(dir.path().join("film.mp4")).unwrap();
    let samples = |mp4: &[u8]| {
        let at = mp4.windows(4).position(|w| w == b"stsz").unwrap();
        u32::from_be_bytes(mp4[at + 12..at + 16].try_into().unwrap())
    };
    assert!((24..1500).contains(&samples(&film())), "{}", samples(&film()));
    succeeds(dir.path(), &format!("{line} --resume"));
    assert_eq!((samples(&film()), names(dir.path())), (1500, vec!["film.mp4".to_string(), "hills.pcast".to_string()]));
}

#[test]
fn fly_writes_y4m_to_standard_output_and_to_a_file() {
    let dir = workplace();
    let how = "--frames 3 --fps 29.97 --size 64x36 --device cpu";
    let output = planecast(dir.path(), &format!("fly hills.pcast -o - {how}"));
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let head = b"YUV4MPEG2 W64 H36 F30000:1001 Ip A1:1 C420jpeg XCOLORRANGE=LIMITED\n";
    assert!(output.stdout.starts_with(head));
    assert_eq!(output.stdout.len(), head.len() + 3 * (6 + 64 * 36 * 3 / 2));
    succeeds(dir.path(), &format!("fly hills.pcast -o film.y4m {how}"));
    assert!(fs::read(dir.path().join("film.y4m")).unwrap() == output.stdout);
    let part = planecast(dir.path(), &format!("fly hills.pcast -o - {how}").replace("--frames 3", "--frames 1..3/3"));
    assert!(part.stdout[head.len()..] == output.stdout[head.len() + 6 + 64 * 36 * 3 / 2..], "the same frames");
    // Whoever reads it may stop.
    let mut child = Command::new(env!("CARGO_BIN_EXE_planecast"))
        .args(format!("fly hills.pcast -o - {how}").replace("--frames 3", "--frames 2000").split_whitespace())
        .current_dir(dir.path())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    child.stdout.take().unwrap().read_exact(&mut [0; 5000]).unwrap();
    assert!(child.wait().unwrap().success());
}

#[test]
fn fly_makes_pictures_that_move() {
    let dir = workplace();
    for name in ["loop.gif", "loop.png"] {
        succeeds(dir.path(), &format!("fly hills.pcast -o {name} --frames 4 --fps 10 --size 33x21 --device cpu"));
    }
    let bytes = |name: &str| fs::read(dir.path().join(name)).unwrap();
    assert!(bytes("loop.gif").starts_with(b"GIF89a\x21\0\x15\0") && bytes("loop.png").starts_with(b"\x89PNG"));
    assert_eq!(bytes("loop.png").windows(4).filter(|w| w == b"fcTL").count(), 4);
    assert_eq!(names(dir.path()), ["hills.pcast", "loop.gif", "loop.png"]);
}

#[cfg(any(feature = "h264", feature = "av1"))]
fn index(mp4: &Path) -> mp4_atom::Moov {
    use mp4_atom::Decode;
    let bytes = fs::read(mp4).unwrap();
    let at = bytes.windows(4).position(|w| w == b"moov").unwrap() - 4;
    mp4_atom::Moov::decode(&mut &bytes[at..]).unwrap()
}

#[cfg(any(feature = "h264", feature = "av1"))]
#[test]
fn fly_makes_a_film_of_one_frame_that_lasts_one_frame() {
    let dir = workplace();
    for frames in [1u32, 2] {
        succeeds(dir.path(), &format!("fly hills.pcast -o one.mp4 --tour --frames {frames} --size 64x64 --device cpu"));
        let moov = index(&dir.path().join("one.mp4"));
        let seconds = moov.mvhd.duration as f64 / f64::from(moov.mvhd.timescale);
        assert!((seconds - f64::from(frames) / 30.0).abs() < 1e-9, "{frames} frames last {seconds} s");
    }
}

#[cfg(any(feature = "h264", feature = "av1"))]
#[test]
fn fly_says_that_an_odd_size_grows() {
    let dir = workplace();
    let how = "--frames 2 --device cpu --size";
    let output = planecast(dir.path(), &format!("fly hills.pcast -o film.mp4 {how} 63x41"));
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.success() && said.contains("film of 63 x 41 pixels is written as 64 x 42"), "{said}");
    let tkhd = &index(&dir.path().join("film.mp4")).trak[0].tkhd;
    assert_eq!((tkhd.width.integer(), tkhd.height.integer()), (64, 42));
    let output = planecast(dir.path(), &format!("fly hills.pcast -o film.mp4 {how} 64x42"));
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.success() && !said.contains("is written as"), "{said}");
}

#[test]
fn a_sky_that_is_left_out_needs_transparency() {
    let dir = workplace();
    let (status, said) = fails(dir.path(), "render hills.pcast -o a.jpg --sky none --device cpu");
    assert_eq!((status, said.contains("has no transparency")), (2, true), "{said}");
    let (status, said) = fails(dir.path(), "fly hills.pcast -o a.y4m --sky none --frames 2 --device cpu");
    assert_eq!((status, said.contains("has no transparency")), (2, true), "{said}");
    succeeds(dir.path(), "render hills.pcast -o a.png --sky none --device cpu --top --size 64x48");
}

#[cfg(any(feature = "h264", feature = "av1"))]
#[test]
fn join_of_parts_is_the_film_made_at_once() {
    let dir = workplace();
    let how = "--size 64x36 --device cpu --shading none";
    let plan = succeeds(dir.path(), "fly hills.pcast -o once.mp4 --plan --frames 60 --size 64x36");
    assert_eq!(plan, "{\"frames\":60,\"segment\":24}\n");
    succeeds(dir.path(), &format!("fly hills.pcast -o once.mp4 --frames 60 {how}"));
    for (name, range) in [("c", "48..60/60"), ("a", "0..24/60"), ("b", "24..48/60"), ("d", "20..60/60")] {
        succeeds(dir.path(), &format!("fly hills.pcast -o {name}.mp4 --frames {range} {how}"));
    }
    let (_, said) = fails(dir.path(), "join a.mp4 c.mp4 -o film.mp4");
    assert!(said.starts_with("frames 24..48 of the film's 60 are in none of the parts"), "{said}");
    let (_, said) = fails(dir.path(), "join a.mp4 d.mp4 -o film.mp4");
    assert!(said.contains("d.mp4: has frames 20..60, some of which a.mp4 has too"), "{said}");
    let (_, said) = fails(dir.path(), "join once.mp4 -o film.mp4");
    assert!(said.starts_with("once.mp4: is not a part of a film"), "{said}");
    succeeds(dir.path(), "join c.mp4 a.mp4 b.mp4 -o film.mp4");
    assert!(fs::read(dir.path().join("film.mp4")).unwrap() == fs::read(dir.path().join("once.mp4")).unwrap());
}

#[test]
fn fly_to_one_folder_by_parts_leaves_the_frames_of_the_film() {
    let dir = workplace();
    let how = "--size 32x20 --device cpu";
    succeeds(dir.path(), &format!("fly hills.pcast -o whole --frames 5 {how}"));
    for range in ["3..5/5", "0..3/5"] {
        succeeds(dir.path(), &format!("fly hills.pcast -o parts --frames {range} {how}"));
    }
    assert_eq!(names(&dir.path().join("parts")), names(&dir.path().join("whole")));
    for name in names(&dir.path().join("whole")) {
        let bytes = |folder: &str| fs::read(dir.path().join(folder).join(&name)).unwrap();
        assert!(bytes("parts") == bytes("whole"), "{name}");
    }
}

#[test]
fn fly_by_ffmpeg_says_when_it_is_not_there() {
    let dir = workplace();
    let line = "fly hills.pcast -o film.mkv --frames 3 --size 64x36 --device cpu --encoder ffmpeg";
    let run = |path: Option<&str>, line: &str| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_planecast"));
        path.into_iter().for_each(|path| _ = command.env("PATH", path));
        command.args(line.split_whitespace()).current_dir(dir.path()).output().unwrap()
    };
    let output = run(Some("/nowhere"), line);
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.code() == Some(2) && said.contains("no program ffmpeg is in the PATH"), "{said}");
    if Command::new("ffmpeg").arg("-version").output().is_err() {
        eprintln!("skipped: films by ffmpeg, which is not installed here");
        return;
    }
    let output = run(None, line);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert!(fs::read(dir.path().join("film.mkv")).unwrap().starts_with(&[0x1a, 0x45, 0xdf, 0xa3]));
    let output = run(None, &format!("{line}:-c:v=nosuch").replace("film.mkv", "other.mkv"));
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.code() == Some(1) && said.contains("--encoder ffmpeg: ffmpeg ended with"), "{said}");
    assert_eq!(names(dir.path()), ["film.mkv", "hills.pcast"]);
}

#[test]
fn render_and_fly_take_broken_tiles_as_empty_where_asked() {
    let dir = workplace();
    let path = dir.path().join("hills.pcast");
    let mut bytes = fs::read(&path).unwrap();
    // The first tile's blob, in its middle.
    let entry = u64::from_le_bytes(bytes[32..40].try_into().unwrap()) as usize;
    let at = u64::from_le_bytes(bytes[entry..entry + 8].try_into().unwrap()) as usize;
    let len = u32::from_le_bytes(bytes[entry + 32..entry + 36].try_into().unwrap()) as usize;
    bytes[at + len / 2] ^= 1;
    fs::write(&path, bytes).unwrap();
    let how = "--size 40x30 --device cpu";
    for line in
        [format!("render hills.pcast -o p.png {how}"), format!("fly hills.pcast -o flight --tour --frames 2 {how}")]
    {
        let (status, text) = fails(dir.path(), &line);
        assert!(status == 1 && text.contains("tile (0, 0) of level 0"), "{text}");
        let output = planecast(dir.path(), &format!("{line} --skip-broken"));
        let text = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success() && text.contains("note: taken as empty: "), "{text}");
    }
    assert!(dir.path().join("p.png").exists() && names(&dir.path().join("flight")).len() >= 2);
}

/// Runs a command by a shell, its standard error and output as the line says.
#[cfg(unix)]
fn shell(dir: &Path, line: &str) -> Output {
    Command::new("sh")
        .args(["-c", line])
        .env("planecast", env!("CARGO_BIN_EXE_planecast"))
        .current_dir(dir)
        .output()
        .unwrap()
}

#[cfg(unix)]
#[test]
fn messages_that_nobody_hears_lose_no_work() {
    let dir = workplace();
    for to in ["2>/dev/full", "2>&-", "2>&1 | true"] {
        for (file, line) in [
            ("s.pcast", "encode procedural:rocks?size=48 -o s.pcast"),
            ("p.png", "render hills.pcast -o p.png --size 8x8 --device cpu --eye -9,90,-9 --pitch 80"),
            ("v.raw", "decode hills.pcast -o v.raw"),
            ("f/000001.png", "fly hills.pcast -o f --frames 2 --size 8x8 --device cpu"),
            ("q.png", "render procedural:rocks?size=48 -o q.png --size 8x8 --device cpu"),
        ] {
            let output = shell(dir.path(), &format!("trap '' PIPE; $planecast {line} {to}"));
            assert!(output.status.success(), "{line} {to}: {output:?}");
            // A pipe's first command may end after its last.
            let there = (0..500).any(|_| {
                std::thread::sleep(std::time::Duration::from_millis(10));
                dir.path().join(file).exists()
            });
            assert!(there, "{line} {to}");
        }
        _ = fs::remove_dir_all(dir.path().join("f"));
        for file in ["s.pcast", "p.png", "v.raw", "q.png"] {
            _ = fs::remove_file(dir.path().join(file));
        }
    }
    let output = shell(dir.path(), "$planecast info nosuch.pcast 2>/dev/full");
    assert_eq!(output.status.code(), Some(1));
    for line in ["render hills.pcast -o - --size 64x64 --device cpu", "info hills.pcast", "man", "completions zsh"] {
        let output = shell(dir.path(), &format!("{{ $planecast {line}; echo $? >status; }} | true"));
        let said = String::from_utf8(output.stderr).unwrap();
        assert!(said.lines().all(|l| !l.starts_with("planecast: ")), "{line}: {said}");
        let status = (0..500).find_map(|_| {
            std::thread::sleep(std::time::Duration::from_millis(10));
            fs::read_to_string(dir.path().join("status")).ok().filter(|s| !s.is_empty())
        });
        assert_eq!(status.as_deref(), Some("0\n"), "{line}");
        fs::remove_file(dir.path().join("status")).unwrap();
    }
}

#[test]
fn encode_that_plans_writes_no_scene() {
    let dir = workplace();
    let plan = succeeds(dir.path(), "encode procedural:hills?size=64 --plan -o s.pcast");
    let plan: serde_json::Value = serde_json::from_str(&plan).unwrap();
    assert_eq!((plan["dims"][0].as_u64(), plan["tiles"].as_u64()), (Some(64), Some(1)));
    assert_eq!(names(dir.path()), ["hills.pcast"]);
}

#[test]
fn render_writes_what_the_name_says() {
    let dir = workplace();
    let how = "--size 40x30 --device cpu --eye -5,30,-2 --yaw 140 --pitch -40";
    for (name, format) in
        [("a.png", image::ImageFormat::Png), ("a.jpg", image::ImageFormat::Jpeg), ("b.JPEG", image::ImageFormat::Jpeg)]
    {
        succeeds(dir.path(), &format!("render hills.pcast -o {name} {how}"));
        let bytes = fs::read(dir.path().join(name)).unwrap();
        assert_eq!(image::guess_format(&bytes).unwrap(), format, "{name}");
        let picture = image::load_from_memory(&bytes).unwrap().into_rgb8();
        let right = image::open(dir.path().join("a.png")).unwrap().into_rgb8();
        let far = right.as_raw().iter().zip(picture.as_raw()).map(|(a, b)| u64::from(a.abs_diff(*b))).sum::<u64>();
        assert!(picture.dimensions() == (40, 30) && far < 12 * right.as_raw().len() as u64, "{name}: {far}");
    }
    for name in ["c.bmp", "c", "c.pcast", "c.png.txt"] {
        let (status, said) = fails(dir.path(), &format!("render nosuch.pcast -o {name} {how}"));
        assert!(status == 2 && said.contains("cannot write") && said.contains("name a .png or .jpg file"), "{said}");
    }
    let output = planecast(dir.path(), &format!("render hills.pcast -o - {how}"));
    assert_eq!(output.stdout, fs::read(dir.path().join("a.png")).unwrap());
    assert_eq!(names(dir.path()), ["a.jpg", "a.png", "b.JPEG", "hills.pcast"]);
}

#[test]
fn path_files_may_begin_with_a_byte_order_mark() {
    let dir = workplace();
    let keys = r#"[{"t":0,"eye":[1,30,3],"yaw":0,"pitch":-5},{"t":1,"eye":[9,30,3],"yaw":9,"pitch":-5}]"#;
    fs::write(dir.path().join("path.json"), format!("\u{feff}{keys}")).unwrap();
    succeeds(dir.path(), "fly hills.pcast -o frames --path path.json --frames 2 --size 8x8 --device cpu");
    assert!(dir.path().join("frames/000001.png").exists());
}

#[test]
fn cli_ramp_tints_a_scene_whole_or_in_tiles() {
    let dir = workplace();
    let heights: Vec<u8> = (0..600 * 500u32).map(|i| (20.0 + 15.0 * (i % 600) as f32 / 600.0) as u8).collect();
    image::GrayImage::from_raw(600, 500, heights).unwrap().save(dir.path().join("h.png")).unwrap();
    succeeds(dir.path(), "encode h.png -o h.pcast");
    let picture = |name: &str, flags: &str| {
        let command =
            format!("render h.pcast -o {name} --size 160x120 --device cpu --shading none --smooth off {flags}");
        let output = planecast(dir.path(), &command);
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        let pixels = image::open(dir.path().join(name)).unwrap().into_rgb8().into_raw();
        (pixels, String::from_utf8(output.stderr).unwrap())
    };
    let (plain, said) = picture("plain.png", "");
    assert!(said.contains("--ramp terrain"), "{said}");
    let (whole, said) = picture("whole.png", "--ramp viridis");
    assert!(!said.contains("--ramp"), "{said}");
    assert!(plain != whole && whole.chunks(3).any(|p| p[0] != p[1]));
    assert!(picture("tiles.png", "--ramp viridis --residency paged").0 == whole);
    assert!(picture("none.png", "--ramp none").0 == plain);
    let output = planecast(dir.path(), "render h.pcast -o no.png --ramp nothing");
    assert_eq!(output.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&output.stderr).contains("no ramp of"));
}

#[test]
fn commands_take_inputs_as_well_as_scenes() {
    let dir = workplace();
    let volume: Vec<u8> = (0..20 * 30 * 10u32).map(|i| u8::from(i % 20 >= 5)).collect();
    fs::write(dir.path().join("v.raw"), volume).unwrap();
    let input = "v.raw --dims 20,30,10";
    let how = "--size 40x30 --device cpu";
    succeeds(dir.path(), &format!("encode {input} -o v.pcast"));
    succeeds(dir.path(), &format!("render v.pcast -o a.png {how}"));
    succeeds(dir.path(), &format!("render {input} -o b.png {how}"));
    assert_eq!(fs::read(dir.path().join("a.png")).unwrap(), fs::read(dir.path().join("b.png")).unwrap());
    // Of a scene nothing is read in another way, which is said.
    let said = |flags: &str| {
        let output = planecast(dir.path(), &format!("render v.pcast -o a.png {how} {flags}"));
        assert!(output.status.success());
        String::from_utf8(output.stderr).unwrap()
    };
    assert!(said("--iso 1").contains("v.pcast: is a scene already"));
    assert!(!said("").contains("already"));
    succeeds(dir.path(), &format!("fly {input} -o frames --frames 2 {how}"));
    let solid = |x: u32| succeeds(dir.path(), &format!("query v.raw {x} 3 3 --dims 20,30,10"));
    assert_eq!([solid(4), solid(5)], [false, true].map(|solid| format!("{{\"solid\":{solid},\"color\":null}}\n")));
    let hit = succeeds(dir.path(), &format!("pick {input} --from -1,3.5,3.5 --dir 1,0,0"));
    assert!(hit.contains("\"voxel\":[5,3,3],\"distance\":6.0"), "{hit}");
    let info = |what: &str| -> serde_json::Value {
        serde_json::from_str(&succeeds(dir.path(), &format!("info {what} --json"))).unwrap()
    };
    assert_eq!(info(input)["content_hash"], info("v.pcast")["content_hash"]);
    // Options of the reader whose names are taken are there under others.
    assert!(fails(dir.path(), &format!("render {input} -o c.png --input-size x")).1.contains("--input-size"));
    assert!(fails(dir.path(), &format!("render {input} -o c.png --dtype u7")).1.contains("possible values: u8"));
    assert!(fails(dir.path(), "render v.raw -o c.png --dims 2,x,3").1.contains("three whole numbers"));
    assert_eq!(names(dir.path()), ["a.png", "b.png", "frames", "hills.pcast", "v.pcast", "v.raw"]);
}

#[test]
fn planecast_and_a_file_opens_it_and_without_a_display_draws_it() {
    let dir = workplace();
    let run = |line: &str| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_planecast"));
        ["DISPLAY", "WAYLAND_DISPLAY"].iter().for_each(|name| _ = command.env_remove(name));
        command.args(line.split_whitespace()).current_dir(dir.path()).output().unwrap()
    };
    let output = run("hills.pcast --size 40x30 --device cpu");
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.success() && said.contains("drawing hills.png instead"), "{said}");
    let last = said.lines().last().unwrap();
    assert!(last.starts_with("hills.png: ") && last.contains(" KiB, ") && last.ends_with("40 x 30 pixels"), "{said}");
    assert!(run("--quiet procedural:rocks?size=32 --size 8x8 --device cpu").stderr.is_empty());
    assert_eq!(names(dir.path()), ["hills.pcast", "hills.png", "rocks.png"]);
    let output = run("");
    let said = String::from_utf8(output.stdout).unwrap();
    assert!(output.status.success() && said.lines().filter(|l| l.starts_with("  planecast ")).count() == 5, "{said}");
    for (line, what) in [
        ("rendr hills.pcast", "'render'"),
        ("render hills.pcast -o a.png --shadng full", "a similar argument exists: '--shading'"),
        ("nosuch.tif", "nosuch.tif: there is no such file, and no command of this name"),
    ] {
        let (status, said) = fails(dir.path(), line);
        assert!(status == 2 && said.contains(what), "{said}");
    }
}

#[test]
fn help_begins_with_examples_and_the_rest_is_made_of_it() {
    let dir = workplace();
    let help = succeeds(dir.path(), "--help");
    let commands = help.lines().skip_while(|l| *l != "Commands:").skip(1).take_while(|l| !l.is_empty());
    let commands: Vec<&str> = commands.filter_map(|l| l.split_whitespace().next()).filter(|c| *c != "help").collect();
    assert!(commands.len() >= 12, "{help}");
    for command in &commands {
        let help = succeeds(dir.path(), &format!("{command} --help"));
        assert!(help.starts_with(&format!("Examples:\n  planecast {command}")), "{help}");
    }
    let render = succeeds(dir.path(), "render --help");
    let groups: Vec<&str> = render.lines().filter(|l| l.ends_with(':') && !l.starts_with(' ')).collect();
    for group in ["Camera:", "Picture:", "Quality:", "Expert:", "Reading an input that is no scene:"] {
        assert!(groups.contains(&group), "{groups:?}");
    }
    assert!(succeeds(dir.path(), "--version").contains("built with "));
    for shell in ["bash", "zsh", "fish", "elvish", "powershell"] {
        assert!(succeeds(dir.path(), &format!("completions {shell}")).contains("look-at"), "{shell}");
    }
    succeeds(dir.path(), "man -o man");
    let pages = names(&dir.path().join("man"));
    assert_eq!(pages.len(), commands.len() + 1, "{pages:?}");
    let page = fs::read_to_string(dir.path().join("man/planecast-render.1")).unwrap();
    assert!(page.contains("planecast render knight.vox") && page.contains("look\\-at"), "{page}");
}

#[test]
fn scenes_keep_what_they_were_made_of() {
    let dir = workplace();
    let name = "procedural:terrain?size=300&seed=3";
    succeeds(dir.path(), &format!("encode {name} -o a.pcast"));
    succeeds(dir.path(), &format!("encode {name} -o p0 --tiles 0..2"));
    succeeds(dir.path(), &format!("encode {name} -o p1 --tiles 2..4"));
    succeeds(dir.path(), "merge p1 p0 -o b.pcast");
    let bytes = fs::read(dir.path().join("a.pcast")).unwrap();
    assert_eq!(fs::read(dir.path().join("b.pcast")).unwrap(), bytes);
    let info = |file: &str| -> serde_json::Value {
        serde_json::from_str(&succeeds(dir.path(), &format!("info {file} --json"))).unwrap()
    };
    let found = info("a.pcast");
    assert_eq!(found["about"]["source"], name, "{found}");
    assert_eq!(found["content_hash"], info(name)["content_hash"]);
    assert!(info("hills.pcast").get("about").is_none());
    // One byte of what is kept, changed.
    let mut wrong = bytes.clone();
    wrong[64 + 16 + 5] ^= 1;
    fs::write(dir.path().join("wrong.pcast"), wrong).unwrap();
    let (status, said) = fails(dir.path(), "verify wrong.pcast");
    assert!(status == 1 && said.contains("byte 64: metadata: a section does not match its checksum"), "{said}");
}

#[cfg(feature = "report")]
#[test]
fn report_of_a_world_in_tiles_says_what_waiting_costs_and_what_not() {
    let dir = workplace();
    let said = succeeds(dir.path(), "report --stream hills.pcast -o out --quick --size 48x32 --device cpu");
    assert!(said.starts_with("At 100 voxels per frame over 100 Mbit/s, 50 ms, with "), "{said}");
    let plots = ["stream-error-time-100.svg", "stream-error-time-4.svg", "stream-memory.svg", "stream-velocity.svg"];
    let tables = ["stream.csv", "stream.html", "stream.json", "stream.md"];
    assert_eq!(names(&dir.path().join("out")), [plots, tables].concat());
    let json = fs::read(dir.path().join("out/stream.json")).unwrap();
    let json: serde_json::Value = serde_json::from_slice(&json).unwrap();
    let rows = json["rows"].as_array().unwrap();
    assert!(rows.len() == 16 && json["frames"] == 12 && json["scene"] == "hills.pcast", "{json}");
    let whole = rows.iter().filter(|row| row["stream"] == "wait" && row["lod"] == 1.0);
    assert!(whole.clone().count() > 0, "{json}");
    for row in whole {
        assert!(row["wrong_voxel_percent"] == 0.0 && row["debt_per_pixel"] == 0.0 && row["flip"] == 0.0, "{row}");
    }
    let page = fs::read_to_string(dir.path().join("out/stream.html")).unwrap();
    assert!(page.contains(said.trim()) && !page.contains("<script"), "{page}");

    let (code, text) = fails(dir.path(), "report -q --stream hills.pcast -o less --quick --memory 1M --device cpu");
    assert!(code == 1 && text.contains("KiB are allowed") && text.ends_with("give more with --memory"), "{text}");
    fs::write(dir.path().join("p.json"), r#"[{"t":0,"eye":[1,20,3],"yaw":0,"pitch":0}]"#).unwrap();
    let (code, text) = fails(dir.path(), "report -q --stream hills.pcast -o still --path p.json");
    assert!(code == 1 && text.starts_with("p.json: the eye stands still"), "{text}");
    for line in ["report --stream --stability -o x", "report hills.pcast --memory 9M -o x", "report --stream -o x"] {
        assert_eq!(planecast(dir.path(), line).status.code(), Some(2), "{line}");
    }
    for (flags, what) in [("--repeat x", "leave out --repeat"), ("--device exact", "exact: rays need")] {
        let (code, text) = fails(dir.path(), &format!("report -q --stream hills.pcast -o x {flags}"));
        assert!(code == 2 && text.contains(what), "{flags}: {text}");
    }
}

#[cfg(target_os = "linux")]
#[test]
fn limits_of_memory_end_in_words() {
    let dir = workplace();
    // What the program itself takes is the system's business.
    let runs = |kib: &u32| {
        shell(dir.path(), &format!("ulimit -c 0; ulimit -v {kib}; exec $planecast --version")).status.success()
    };
    let least = (20_000..1_000_000).step_by(20_000).find(runs).unwrap();
    let mut refused = 0;
    for line in [
        "encode procedural:terrain?size=256 -o s.pcast",
        "render procedural:rocks?size=100 -o p.png --size 1600x1200 --device cpu",
    ] {
        for kib in [5_000, 30_000, 90_000].map(|more| least + more) {
            let output = shell(dir.path(), &format!("ulimit -c 0; ulimit -v {kib}; exec $planecast {line}"));
            let said = String::from_utf8_lossy(&output.stderr);
            let status = output.status.code();
            assert!(matches!(status, Some(0 | 1)), "{line} in {kib} KiB: {:?}: {said}", output.status);
            if status == Some(1) {
                refused += 1;
                // Rust 1.95's own line on memory, and its hint at a backtrace, come first; stable Rust has no way to silence them.
                let last = said.lines().last().unwrap_or_default();
                let plain = last.starts_with("planecast: ") && last.contains("emory");
                let trace = said.contains("please report") || said.contains("stack backtrace");
                assert!(plain && !trace, "{line} in {kib} KiB: {said}");
            }
            for file in names(dir.path()) {
                // What encode has finished stays for --resume.
                let known = ["hills.pcast", "s.pcast", "p.png", ".s.pcast.unfinished"];
                assert!(known.contains(&&*file), "{line} leaves {file}");
            }
        }
    }
    assert!(refused > 0);
}

#[cfg(unix)]
#[test]
fn a_killed_program_leaves_nothing_that_the_same_command_does_not_tidy_away() {
    let dir = workplace();
    let mut command = Command::new(env!("CARGO_BIN_EXE_planecast"));
    let line = "encode procedural:terrain?size=1024 -o s.pcast --threads 1";
    let mut child =
        command.args(line.split_whitespace()).current_dir(dir.path()).stderr(Stdio::null()).spawn().unwrap();
    while names(dir.path()).len() < 2 {
        assert!(child.try_wait().unwrap().is_none(), "it ended too soon");
        std::thread::sleep(std::time::Duration::from_millis(1));
    }
    child.kill().unwrap();
    child.wait().unwrap();
    succeeds(dir.path(), "encode procedural:terrain?size=64 -o s.pcast");
    assert_eq!(names(dir.path()), ["hills.pcast", "s.pcast"]);
}

/// The numbers of an NPY file, and its shape as its header has it.
fn npy<T: Copy + bytemuck::AnyBitPattern>(path: &Path) -> (String, Vec<T>) {
    let bytes = fs::read(path).unwrap();
    let from = 10 + usize::from(u16::from_le_bytes([bytes[8], bytes[9]]));
    let header = String::from_utf8(bytes[10..from].to_vec()).unwrap();
    let shape = header.split("'shape': ").nth(1).unwrap().split(", }").next().unwrap().to_owned();
    (shape, bytes[from..].chunks_exact(size_of::<T>()).map(bytemuck::pod_read_unaligned).collect())
}

#[test]
fn render_from_many_poses_makes_the_pictures_of_each() {
    let dir = workplace();
    let poses =
        r#"[{"eye": [-5, 30, -2], "yaw": 140, "pitch": -40}, {"eye": [20, 40, 20], "pitch": -90, "size": [16, 20]}]"#;
    fs::write(dir.path().join("poses.json"), poses).unwrap();
    succeeds(
        dir.path(),
        "render hills.pcast --cameras poses.json -o out --size 40x30 --device cpu --voxel maps --depth --stats s.json",
    );
    assert_eq!(names(&dir.path().join("out")), ["000000.depth.npy", "000000.png", "000001.depth.npy", "000001.png"]);
    assert_eq!(names(&dir.path().join("maps")), ["000000.voxel.npy", "000001.voxel.npy"]);
    let one = "render hills.pcast -o p.png --eye -5,30,-2 --yaw 140 --pitch -40 --size 40x30 --device cpu --depth d.npy --voxel v.npy";
    succeeds(dir.path(), one);
    for (one, many) in
        [("p.png", "out/000000.png"), ("d.npy", "out/000000.depth.npy"), ("v.npy", "maps/000000.voxel.npy")]
    {
        assert!(fs::read(dir.path().join(one)).unwrap() == fs::read(dir.path().join(many)).unwrap(), "{many}");
    }
    assert_eq!(npy::<f32>(&dir.path().join("out/000001.depth.npy")).0, "(20, 16)");
    let stats: serde_json::Value = serde_json::from_slice(&fs::read(dir.path().join("s.json")).unwrap()).unwrap();
    assert_eq!((stats[0]["width"].as_u64(), stats[1]["height"].as_u64()), (Some(40), Some(20)));

    fs::write(dir.path().join("wrong.json"), r#"[{"eye": [0, 0, 0], "fov": 200}]"#).unwrap();
    let (code, text) = fails(dir.path(), "render hills.pcast --cameras wrong.json -o out");
    assert!(code == 1 && text.starts_with("wrong.json: pose 0: ") && text.contains("200"), "{text}");
    assert_eq!(
        planecast(dir.path(), "render hills.pcast --cameras poses.json --eye 1,2,3 -o out").status.code(),
        Some(2)
    );
}

#[test]
fn render_draws_projections_and_refuses_what_they_are_not() {
    let dir = workplace();
    let eye = "--eye 24.5,18.4,20.5 --device cpu --lod off --depth d.npy";
    succeeds(dir.path(), &format!("render hills.pcast -o p.png --projection equirect {eye} --size 64x32"));
    let (shape, ranges) = npy::<f32>(&dir.path().join("d.npy"));
    assert_eq!(shape, "(32, 64)");
    // The lowest row looks nearly straight down: column (24, 20) is 2 + (24·7 + 20·3) % 11 + 1 = 11 high.
    assert!(ranges[31 * 64..].iter().all(|&r| (7.4..7.6).contains(&r)), "{:?}", &ranges[31 * 64..]);
    assert!(ranges[..64].iter().all(|r| r.is_infinite()));
    for (flags, what) in [
        ("--projection equirect --fov 90", "leave it out"),
        ("--projection cube --size 64x32", "1536x1024"),
        ("--projection lidar:4x8 --size 64x32", "8 × 4"),
        ("--projection fisheye --fov 0", "above 0"),
    ] {
        let (code, text) = fails(dir.path(), &format!("render hills.pcast -o p.png {flags}"));
        assert!(code == 2 && text.contains(what), "{flags}: {text}");
    }
    assert_eq!(planecast(dir.path(), "render hills.pcast -o p.png --projection lidar:4").status.code(), Some(2));
    assert!(fails(dir.path(), "render hills.pcast -o p.ply").1.contains("cannot write .ply"));
}

#[test]
fn lidar_scans_are_point_clouds_that_encode_reads_in_their_place() {
    let dir = workplace();
    let scan =
        "render hills.pcast --projection lidar:9x32 --fov 80 --eye 24.3,18.4,20.6 --yaw 30 --device cpu --lod off";
    succeeds(dir.path(), &format!("{scan} -o s.npy --depth d.npy"));
    assert_eq!(names(dir.path()), ["d.npy", "hills.pcast", "s.beams.json", "s.npy"]);
    let (shape, values) = npy::<f64>(&dir.path().join("s.npy"));
    let (_, ranges) = npy::<f32>(&dir.path().join("d.npy"));
    assert_eq!((shape.as_str(), ranges.len()), ("(9, 32, 4)", 9 * 32));
    let beams: serde_json::Value = serde_json::from_slice(&fs::read(dir.path().join("s.beams.json")).unwrap()).unwrap();
    let angle = |list: &str, i: usize| beams[list][i].as_f64().unwrap();
    assert_eq!([angle("elevation", 0), angle("elevation", 4), angle("elevation", 8)], [40.0, 0.0, -40.0]);
    let mut met = 0;
    for (i, point) in values.chunks_exact(4).enumerate() {
        assert_eq!(point[3] as f32, ranges[i]);
        if point[3].is_finite() {
            met += 1;
            // Each point is where its beam's angles and range say.
            let (up, round) = (angle("elevation", i / 32).to_radians(), (30.0 + angle("azimuth", i % 32)).to_radians());
            let dir = [round.sin() * up.cos(), up.sin(), -round.cos() * up.cos()];
            for (axis, eye) in [24.3, 18.4, 20.6].into_iter().enumerate() {
                assert!((eye + dir[axis] * point[3] - point[axis]).abs() < 1e-6, "{i}: {point:?}");
            }
        }
    }
    assert!(met > 60, "{met}");
    for kind in ["ply", "las"] {
        succeeds(dir.path(), &format!("{scan} -o s.{kind}"));
        succeeds(dir.path(), &format!("encode s.{kind} -o {kind}.pcast --voxel 1 --point-size 1"));
        let info: serde_json::Value =
            serde_json::from_str(&succeeds(dir.path(), &format!("info {kind}.pcast --json"))).unwrap();
        let solid = info["solid_voxels"].as_u64().unwrap();
        assert!(solid > 40 && solid <= met, "{kind}: {solid} of {met}");
    }
}

#[test]
fn viewsheds_are_written_as_the_name_says() {
    let dir = workplace();
    let shed = "viewshed hills.pcast --eye 24.5,40,20.5 --eye 2.5,18,2.5";
    for name in ["v.npy", "v.png", "v.tif"] {
        succeeds(dir.path(), &format!("{shed} -o {name}"));
    }
    let (shape, counts) = npy::<u16>(&dir.path().join("v.npy"));
    assert_eq!(shape, "(40, 48)");
    // The columns that the eyes stand over.
    assert!(counts[20 * 48 + 24] >= 1 && counts[2 * 48 + 2] >= 1 && counts.iter().all(|&c| c <= 2));
    let hidden = counts.iter().filter(|&&c| c < 2).count();
    assert!((100..1900).contains(&hidden), "{hidden}");
    let grey = image::open(dir.path().join("v.png")).unwrap().into_luma8();
    assert!(grey.iter().zip(&counts).all(|(g, c)| *g == [0, 128, 255][usize::from(*c)]));
    let (code, text) = fails(dir.path(), "viewshed hills.pcast --eye 1,50,1 -o v.csv");
    assert!(code == 2 && text.contains(".tif"), "{text}");
    assert_eq!(planecast(dir.path(), "viewshed hills.pcast -o v.npy").status.code(), Some(2));
}

#[cfg(feature = "h264")]
#[test]
fn films_of_the_whole_sphere_tell_players() {
    let dir = workplace();
    let film = |projection: &str| {
        let flags = "--frames 3 --device cpu --shading none";
        succeeds(dir.path(), &format!("fly hills.pcast -o f.mp4 --size 64x32 --projection {projection} {flags}"));
        fs::read(dir.path().join("f.mp4")).unwrap()
    };
    let says = |film: &[u8]| film.windows(4).any(|w| w == b"sv3d");
    assert!(says(&film("equirect")) && !says(&film("fisheye")) && !says(&film("perspective")));
}
