//! The window, under a display of its own: what it shows is what `render` draws, and it goes on whatever happens.
#![cfg(all(feature = "view", target_os = "linux"))]

use std::fs;
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};

use planecast::measure::compare::{Difference, pictures};
use serde_json::{Value, json};

const PLANECAST: &str = env!("CARGO_BIN_EXE_planecast");

/// An X server without a screen, and a folder with a scene.
struct Place {
    server: Child,
    display: String,
    dir: tempfile::TempDir,
}

impl Drop for Place {
    fn drop(&mut self) {
        let _ = self.server.kill();
        let _ = self.server.wait();
    }
}

impl Place {
    fn new() -> Place {
        let mut server = Command::new("Xvfb")
            .args(["-displayfd", "1", "-screen", "0", "1024x768x24", "-nolisten", "tcp"])
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .expect("Xvfb is installed (./test does it)");
        let mut number = String::new();
        BufReader::new(server.stdout.as_mut().unwrap()).read_line(&mut number).unwrap();
        let dir = tempfile::tempdir().unwrap();
        let place = Place { server, display: format!(":{}", number.trim()), dir };
        place.succeeds("encode procedural:rocks?size=64&seed=2 -o a.pcast");
        place
    }

    fn path(&self, name: &str) -> std::path::PathBuf {
        self.dir.path().join(name)
    }

    fn command(&self, line: &str) -> Command {
        let mut command = Command::new(PLANECAST);
        command.args(line.split_whitespace()).current_dir(self.dir.path());
        command.env("DISPLAY", &self.display).env_remove("WAYLAND_DISPLAY").env_remove("WAYLAND_SOCKET");
        command.env("XDG_STATE_HOME", self.path("state")).env("XDG_RUNTIME_DIR", self.dir.path());
        command
    }

    fn run(&self, mut command: Command) -> Output {
        // A window that hangs must not hang the tests.
        let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        for _ in 0..3000 {
            if child.try_wait().unwrap().is_some() {
                return child.wait_with_output().unwrap();
            }
            std::thread::sleep(std::time::Duration::from_millis(100));
        }
        let _ = child.kill();
        panic!("{command:?} still runs after five minutes");
    }

    /// Standard output of a command that ends well.
    fn succeeds(&self, line: &str) -> String {
        self.succeeds_as(self.command(line))
    }

    fn succeeds_as(&self, command: Command) -> String {
        let text = format!("{command:?}");
        let output = self.run(command);
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(output.status.success() && !said.contains("panicked"), "{text}: {said}");
        String::from_utf8(output.stdout).unwrap()
    }

    /// Tells all programs on the display how fine it is.
    fn dots_an_inch(&self, dots: u32) {
        use x11rb::connection::Connection;
        use x11rb::protocol::xproto::{AtomEnum, ConnectionExt as _, PropMode};
        use x11rb::wrapper::ConnectionExt as _;
        let (server, screen) = x11rb::connect(Some(&self.display)).unwrap();
        let (root, text) = (server.setup().roots[screen].root, format!("Xft.dpi:\t{dots}\n"));
        // A change of the display's settings is heard at their owner's window, where a desktop runs, and at the windows
        // themselves.
        let windows = server.query_tree(root).unwrap().reply().unwrap().children;
        for window in [root].into_iter().chain(windows) {
            let (property, kind) = (AtomEnum::RESOURCE_MANAGER, AtomEnum::STRING);
            let set = server.change_property8(PropMode::REPLACE, window, property, kind, text.as_bytes());
            set.unwrap().check().unwrap();
        }
    }

    /// Waits for a file that a script writes, as long as the script runs.
    fn once_there(&self, name: &str, child: &mut Child) {
        for _ in 0..3000 {
            if self.path(name).exists() || child.try_wait().unwrap().is_some() {
                return;
            }
            std::thread::sleep(std::time::Duration::from_millis(100));
        }
        panic!("{name} is not there after five minutes");
    }

    fn script(&self, actions: Value) -> String {
        fs::write(self.path("script.json"), actions.to_string()).unwrap();
        "--script script.json".into()
    }

    fn picture(&self, name: &str) -> ([u32; 2], Vec<[u8; 4]>) {
        let image = image::open(self.path(name)).unwrap_or_else(|e| panic!("{name}: {e}")).to_rgba8();
        (image.dimensions().into(), image.pixels().map(|p| p.0).collect())
    }

    fn json(&self, name: &str) -> Value {
        serde_json::from_str(&fs::read_to_string(self.path(name)).unwrap()).unwrap()
    }

    /// Draws a command that the window printed, as `again.png`.
    fn again(&self, printed: &str) {
        let line = printed.strip_prefix("planecast ").unwrap().replace("-o view.png", "-o again.png");
        self.succeeds(&line);
    }
}

/// Words on the screen, joined.
fn words(figures: &Value) -> String {
    figures["words"].as_array().unwrap().iter().map(|w| w.as_str().unwrap()).collect::<Vec<_>>().join("\n")
}

fn eye(command: &str) -> &str {
    command.split_whitespace().skip_while(|w| *w != "--eye").nth(1).unwrap()
}

#[test]
fn window_shows_what_render_draws_while_it_flies_and_is_resized() {
    let place = Place::new();
    let script = place.script(json!([
        {"t": 0, "key": "Tab"},
        {"t": 0.1, "grab": "first.png"},
        {"t": 0.1, "key": "KeyC"},
        {"t": 0.1, "figures": "first.json"},
        {"t": 0.1, "press": "KeyW"},
        {"t": 0.2, "look": [30, -12]},
        {"t": 0.3, "press": "KeyQ"},
        {"t": 0.4, "release": "KeyQ"},
        {"t": 0.5, "release": "KeyW"},
        {"t": 0.5, "resize": [333, 207]},
        {"t": 0.6, "screenshot": "shot.png"},
        {"t": 0.6, "figures": "figures.json"},
        {"t": 0.7, "quit": {}}
    ]));
    let out = place.succeeds(&format!("view a.pcast --window 320x200 --device gpu {script}"));
    let commands: Vec<&str> = out.lines().collect();
    assert_eq!(commands.len(), 2, "{out}");

    place.again(commands[0]);
    let (shown, drawn) = (place.picture("first.png"), place.picture("again.png"));
    assert_eq!((shown.0, drawn.0), ([320, 200], [320, 200]));
    assert_eq!(pictures(&shown.1, &drawn.1), Difference::default(), "what the window shows");
    assert!(shown.1.iter().any(|p| *p != shown.1[0]), "something is in the picture");
    // The comparison sees one pixel that is one off.
    let mut planted = shown.1.clone();
    planted[777][1] ^= 1;
    assert_eq!(pictures(&planted, &drawn.1), Difference { pixels: 1, greatest: 1, first: Some(777) });

    place.again(commands[1]);
    let (shot, drawn) = (place.picture("shot.png"), place.picture("again.png"));
    assert_eq!((shot.0, drawn.0), ([333, 207], [333, 207]));
    assert_eq!(pictures(&shot.1, &drawn.1), Difference::default(), "the screenshot after flight and resize");
    assert_ne!(eye(commands[0]), eye(commands[1]), "W flies");
    assert!(commands[1].contains("--roll -"), "Q rolls: {}", commands[1]);
    // Rows of 320 pixels can be copied onto the surface; those of 333 are written into it.
    assert_eq!(place.json("first.json")["present"], "copied");
    let figures = place.json("figures.json");
    assert_eq!(figures["present"], "written");
    assert_eq!((&figures["stats"]["width"], &figures["stats"]["kernel"]), (&json!(333), &json!("workgroup")));
}

#[test]
fn window_flies_a_world_in_tiles() {
    let place = Place::new();
    for device in ["cpu", "gpu"] {
        let script = place.script(json!([
            {"t": 0, "key": "Tab"},
            {"t": 0.1, "wait": {}},
            {"t": 0.1, "hover": [160, 180]},
            {"t": 0.2, "screenshot": "here.png"},
            {"t": 0.2, "figures": "here.json"},
            {"t": 0.2, "press": "KeyW"},
            {"t": 0.5, "release": "KeyW"},
            {"t": 0.5, "key": "KeyX"},
            {"t": 0.5, "wait": {}},
            {"t": 0.6, "screenshot": "there.png"},
            {"t": 0.6, "figures": "there.json"},
            {"t": 0.6, "quit": {}}
        ]));
        let world = "procedural:hills?size=inf&seed=1";
        let flags = "--window 320x200 --memory 64M --stream deadline:0";
        let out = place.succeeds(&format!("view {world} --device {device} {flags} {script}"));
        let commands: Vec<&str> = out.lines().collect();
        assert_eq!(commands.len(), 2, "{out}");
        assert_ne!(eye(commands[0]), eye(commands[1]), "W flies");
        for (command, picture) in commands.into_iter().zip(["here.png", "there.png"]) {
            place.again(&command.replace('\'', ""));
            let (shot, drawn) = (place.picture(picture).1, place.picture("again.png").1);
            assert_eq!(pictures(&shot, &drawn), Difference::default(), "{device}: {picture}");
            assert!(shot.iter().any(|p| *p != shot[0]), "something is in the picture");
        }
        let [here, there] = ["here.json", "there.json"].map(|name| place.json(name));
        let paging = &here["stats"];
        assert_eq!((&paging["debt"], &paging["tiles_missing"]), (&json!(0), &json!(0)), "{device}: {here}");
        assert!(paging["bytes_resident"].as_u64().unwrap() <= 64 << 20, "{device}: {paging}");
        assert!(!words(&here).contains("levels too coarse"), "{device}: {}", words(&here));
        assert!(here["hover"].as_str().unwrap().starts_with("voxel "), "{device}: {here}");
        // What needs the whole world says so.
        assert!(words(&there).contains("no error map"), "{device}: {}", words(&there));
    }
    // A scene in tiles is the scene.
    let script = place.script(json!([
        {"t": 0, "wait": {}},
        {"t": 0.1, "screenshot": "tiles.png"},
        {"t": 0.1, "quit": {}}
    ]));
    let out = place.succeeds(&format!("view a.pcast --residency paged --window 320x200 --device cpu {script}"));
    assert!(out.contains(" --residency paged "), "{out}");
    place.again(&out.trim().replace(" --residency paged ", " "));
    assert_eq!(pictures(&place.picture("tiles.png").1, &place.picture("again.png").1), Difference::default());
}

#[test]
fn window_goes_on_after_a_lost_device_no_size_and_broken_files() {
    let place = Place::new();
    fs::write(place.path("broken.pcast"), &fs::read(place.path("a.pcast")).unwrap()[..200]).unwrap();
    let script = place.script(json!([
        {"t": 0, "key": "Tab"},
        {"t": 0.1, "lose_device": {}},
        {"t": 0.3, "figures": "lost.json"},
        {"t": 0.3, "resize": [0, 0]},
        {"t": 0.4, "resize": [300, 180]},
        {"t": 0.5, "drop": "broken.pcast"},
        {"t": 0.6, "figures": "broken.json"},
        {"t": 0.6, "drop": "procedural:shapes?size=48"},
        {"t": 0.7, "press": "Space"},
        {"t": 0.8, "screenshot": "shot.png"},
        {"t": 0.9, "figures": "dropped.json"},
        {"t": 0.9, "quit": {}}
    ]));
    let out = place.succeeds(&format!("view a.pcast --window 320x200 --device gpu {script}"));
    assert!(words(&place.json("lost.json")).contains("opened anew"), "{}", words(&place.json("lost.json")));
    assert!(words(&place.json("broken.json")).contains("broken.pcast"), "{}", words(&place.json("broken.json")));
    assert_ne!(place.json("broken.json")["stats"]["columns_visited"], 0, "it draws on after both");
    let command = out.lines().next().unwrap();
    assert!(command.contains("--size 300x180"), "{command}");
    place.succeeds("encode procedural:shapes?size=48 -o shapes.pcast");
    let scene = command.split_whitespace().nth(2).unwrap();
    place.again(&command.replace(scene, "shapes.pcast"));
    assert_eq!(pictures(&place.picture("shot.png").1, &place.picture("again.png").1), Difference::default());
}

#[test]
fn window_goes_on_after_a_lost_surface_sleep_and_a_change_of_resolution() {
    let place = Place::new();
    let script = place.script(json!([
        {"t": 0, "key": "Tab"},
        {"t": 0.1, "surface": "outdated"},
        {"t": 0.2, "surface": "lost"},
        {"t": 0.3, "grab": "renewed.png"},
        {"t": 0.3, "figures": "renewed.json"},
        {"t": 0.4, "press": "KeyW"},
        {"t": 0.4, "sleep": 3600},
        {"t": 0.6, "occluded": true},
        {"t": 0.7, "figures": "occluded.json"},
        {"t": 0.7, "occluded": false},
        {"t": 0.8, "scale": 2},
        {"t": 0.9, "resize": [320, 192]},
        {"t": 1, "grab": "scaled.png"},
        {"t": 1, "figures": "scaled.json"},
        {"t": 1, "key": "KeyC"},
        {"t": 1.1, "scale": 1},
        {"t": 1.2, "figures": "back.json"},
        {"t": 1.2, "quit": {}}
    ]));
    let mut command = place.command(&format!("view a.pcast --window 320x200 --device gpu {script}"));
    let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    place.once_there("occluded.json", &mut child);
    place.dots_an_inch(192);
    place.once_there("scaled.json", &mut child);
    place.dots_an_inch(96);
    let output = child.wait_with_output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success() && !said.contains("panicked"), "{said}");

    assert_eq!(place.json("renewed.json")["surfaces_renewed"], json!([1, 1]));
    let out = String::from_utf8(output.stdout).unwrap();
    let command = out.lines().next().unwrap();
    place.again(&command.replace('\'', ""));
    let (shown, drawn) = (place.picture("scaled.png"), place.picture("again.png"));
    assert_eq!((shown.0, drawn.0), ([320, 192], [320, 192]));
    assert_eq!(pictures(&shown.1, &drawn.1), Difference::default(), "at twice the pixels a point");
    // Sleep lets go of keys, and the hour does not pass in the scene: the view is still the one from before.
    place.again(&command.replace("320x192", "320x200"));
    assert_eq!(pictures(&place.picture("renewed.png").1, &place.picture("again.png").1), Difference::default());
    let scaled = place.json("scaled.json");
    assert_eq!((&scaled["scale"], &scaled["window"]), (&json!(2.0), &json!([320, 192])));
    assert_eq!(place.json("back.json")["scale"], json!(1.0));
}

#[test]
fn window_without_an_adapter_is_drawn_in_by_the_cpu_and_says_so() {
    let place = Place::new();
    let script = place.script(json!([
        {"t": 0.1, "press": "KeyW"},
        {"t": 0.4, "release": "KeyW"},
        {"t": 0.5, "grab": "shown.png"},
        {"t": 0.5, "key": "KeyC"},
        {"t": 0.5, "figures": "figures.json"},
        {"t": 0.5, "quit": {}}
    ]));
    let mut command = place.command(&format!("view a.pcast --window 240x160 {script}"));
    command.env("VK_ICD_FILENAMES", "/dev/null").env("VK_DRIVER_FILES", "/dev/null");
    let out = place.succeeds_as(command);
    place.again(out.lines().next().unwrap());
    let (shown, drawn) = (place.picture("shown.png"), place.picture("again.png"));
    assert_eq!(shown.0, [240, 160]);
    assert_eq!(pictures(&shown.1, &drawn.1), Difference::default());
    let figures = place.json("figures.json");
    assert!(words(&figures).starts_with("drawing on the cpu: no GPU adapter"), "{}", words(&figures));
    assert_eq!(figures["stats"]["device"], "cpu");

    let mut command = place.command("view a.pcast --device gpu");
    command.env("VK_ICD_FILENAMES", "/dev/null").env("VK_DRIVER_FILES", "/dev/null");
    let output = place.run(command);
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.code() == Some(1) && said.contains("no GPU adapter"), "{said}");
}

#[test]
fn window_records_what_fly_flies_maps_errors_and_remembers_the_view() {
    let place = Place::new();
    let script = place.script(json!([
        {"t": 0, "key": "KeyR"},
        {"t": 0, "press": "KeyD"},
        {"t": 0.8, "release": "KeyD"},
        {"t": 0.9, "key": "KeyR"},
        {"t": 1, "key": "KeyX"},
        {"t": 1.1, "figures": "map.json"},
        {"t": 1.1, "key": "KeyX"},
        {"t": 1.2, "key": "KeyP"},
        {"t": 1.5, "figures": "playing.json"},
        {"t": 2.3, "key": "KeyC"},
        {"t": 2.3, "quit": {}}
    ]));
    let out = place.succeeds(&format!("view a.pcast --window 160x100 --device cpu --target-fps 200 {script}"));
    assert!(words(&place.json("map.json")).contains("show exactly the same voxel"));
    let playing = words(&place.json("playing.json"));
    assert!(playing.contains("playing, ") && playing.contains("holding 200 fps"), "{playing}");
    assert!(out.lines().next().unwrap().contains("planecast fly a.pcast -o flight.mp4 --path path-1.json"), "{out}");
    place.succeeds("fly a.pcast -o frames --path path-1.json --frames 3 --size 32x20 --device cpu");
    assert!(place.path("frames").is_dir());

    // The flight ends where it was recorded to end, and there the next window begins.
    let left = eye(out.lines().nth(1).unwrap()).to_owned();
    let script = place.script(json!([{"t": 0, "key": "KeyC"}, {"t": 0.1, "quit": {}}]));
    let again = place.succeeds(&format!("view a.pcast --window 160x100 --device cpu {script}"));
    let numbers = |eye: &str| eye.split(',').map(|v| v.parse::<f64>().unwrap()).collect::<Vec<_>>();
    for (a, b) in numbers(&left).iter().zip(numbers(eye(&again))) {
        assert!((a - b).abs() < 1e-9, "{left} {again}");
    }
}

#[test]
fn window_tints_land_without_colours_and_its_command_does_too() {
    let place = Place::new();
    let heights = image::GrayImage::from_fn(96, 80, |x, y| image::Luma([(20 + x / 4 + y / 5) as u8]));
    heights.save(place.path("h.png")).unwrap();
    place.succeeds("encode h.png -o h.pcast");
    let script = place.script(json!([
        {"t": 0.2, "screenshot": "shot.png"},
        {"t": 0.4, "quit": {}},
    ]));
    let printed = place.succeeds(&format!("view h.pcast --window 240x160 --device cpu {script}"));
    assert!(printed.contains("h.pcast --ramp terrain"), "{printed}");
    place.again(printed.trim());
    let (shot, again) = (place.picture("shot.png").1, place.picture("again.png").1);
    assert!(shot.iter().any(|p| p[1] > p[2]), "land is green, neither grey nor sky");
    assert_eq!(pictures(&shot, &again), Difference::default());

    // An input is read for the command as it was for the window.
    let printed = place.succeeds(&format!("view h.png --height-scale 0.5 --window 240x160 --device cpu {script}"));
    assert!(printed.contains("h.png --height-scale=0.5 -o view.png"), "{printed}");
    place.again(printed.trim());
    let (low, again) = (place.picture("shot.png").1, place.picture("again.png").1);
    assert_eq!(pictures(&low, &again), Difference::default());
    assert_ne!(low, shot);
}

#[test]
fn window_orbits_a_volume_moves_its_threshold_and_measures() {
    let place = Place::new();
    const N: usize = 24;
    let value = |i: usize| {
        let at = [i % N, i / N % N, i / N / N].map(|v| v as f64 - 11.5);
        (220.0 - 16.0 * at.iter().map(|v| v * v).sum::<f64>().sqrt()).max(0.0) as u8
    };
    let head = format!("{{'descr': '|u1', 'fortran_order': False, 'shape': ({N}, {N}, {N}), }}");
    let mut npy = [&b"\x93NUMPY\x01\x00\x76\x00"[..], format!("{head:<117}\n").as_bytes()].concat();
    npy.extend((0..N * N * N).map(value));
    fs::write(place.path("ball.npy"), npy).unwrap();
    let script = place.script(json!([
        {"t": 0, "wait": {}},
        {"t": 0, "key": "KeyL"},
        {"t": 0, "click": [150, 100]},
        {"t": 0, "click": [170, 100]},
        {"t": 0, "figures": "before.json"},
        {"t": 0.1, "drag": {"from": [100, 100], "to": [160, 90]}},
        {"t": 0.2, "tune": {"threshold": 150}},
        {"t": 0.3, "wait": {}},
        {"t": 0.4, "screenshot": "shot.png"},
        {"t": 0.4, "figures": "after.json"},
        {"t": 0.5, "key": "KeyX"},
        {"t": 0.6, "figures": "map.json"},
        {"t": 0.6, "quit": {}}
    ]));
    let out = place.succeeds(&format!("view ball.npy --window 320x200 --device cpu {script}"));
    let before = place.json("before.json");
    assert_eq!(before["mode"], "orbit");
    // The places lie in the middle of the picture, 20 of its 200 pixels apart, as far away as a ball of 24 voxels is that fills it.
    let said = words(&before);
    let length: f64 = said.split(" voxels: ").next().unwrap().rsplit([' ', '\n']).next().unwrap().parse().unwrap();
    assert!(said.contains(" across, ") && (1.0..6.0).contains(&length), "{said}");
    let command = out.lines().next().unwrap();
    assert!(command.starts_with("planecast render ball.npy --iso 150 -o view.png"), "{command}");
    place.again(&command.replace('\'', ""));
    assert_eq!(pictures(&place.picture("shot.png").1, &place.picture("again.png").1), Difference::default());
    let after = place.json("after.json");
    assert_eq!((&after["threshold"], &after["preview"]), (&json!(150.0), &Value::Null), "encoded as encode does it");
    assert!(place.json("map.json")["faults"].is_u64(), "errors are counted");
}

#[test]
fn window_that_cannot_be_opened_is_a_plain_error() {
    let place = Place::new();
    let fails = |line: &str, display: &str| {
        let mut command = place.command(line);
        command.env("DISPLAY", display);
        let output = place.run(command);
        let said = String::from_utf8(output.stderr).unwrap();
        assert!(
            said.starts_with("planecast: ") && said.lines().count() == 1 && !said.contains(".rs"),
            "{line}: {said}"
        );
        (output.status.code(), said)
    };
    let (code, said) = fails("view a.pcast", ":4711");
    assert!(code == Some(1) && said.contains("no window can be opened"), "{said}");
    let there = place.display.as_str();
    assert!(fails("view nothing.pcast --device cpu", there).1.contains("nothing.pcast: "));
    assert_eq!(fails("view a.pcast --device cpu --kernel workgroup", there).0, Some(2));
    fs::write(place.path("bad.json"), r#"[{"t":0,"jump":1}]"#).unwrap();
    assert!(fails("view a.pcast --script bad.json", there).1.contains("bad.json: action 1: unknown variant `jump`"));
    let script = place.script(json!([{"t": 0, "screenshot": "no/folder/a.png"}]));
    assert!(fails(&format!("view a.pcast --device cpu {script}"), there).1.contains("no/folder"));
    assert!(!Path::new("no").exists());
}
