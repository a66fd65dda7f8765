//! Films by the program ffmpeg, where the user has it: frames go to it through a pipe.

use std::io::{self, BufWriter, Read};
use std::path::Path;
use std::process::{Child, ChildStdin, Command, Stdio};
use std::thread::JoinHandle;

use planecast_encoder::{Error, Result};

use super::{Rate, Yuv, y4m_frame, y4m_head};

/// Endings that ffmpeg is asked for, and its name of each format.
pub const ENDINGS: [(&str, &str); 4] = [("mp4", "mp4"), ("mov", "mov"), ("mkv", "matroska"), ("webm", "webm")];

/// Whether the program is there.
pub fn check() -> Result<()> {
    let found = Command::new("ffmpeg")
        .arg("-version")
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .status();
    match found {
        Ok(status) if status.success() => Ok(()),
        _ => Err(Error::Argument(
            "--encoder ffmpeg: no program ffmpeg is in the PATH; install it, or leave --encoder out for H.264".into(),
        )),
    }
}

/// A film on its way through ffmpeg.
pub struct Pipe {
    child: Child,
    stdin: BufWriter<ChildStdin>,
    said: JoinHandle<String>,
}

fn fault(e: impl std::fmt::Display) -> Error {
    Error::Limit(format!("--encoder ffmpeg: {e}"))
}

impl Pipe {
    /// `ending` says what is written to `output`, whatever its name. Without arguments: H.264 by x264 in MP4, ffmpeg's own choice
    /// in other files.
    pub fn open(output: &Path, ending: &str, arguments: &[String], size: [usize; 2], rate: Rate) -> Result<Pipe> {
        let format = ENDINGS.iter().find(|(e, _)| *e == ending).map_or(ending, |(_, format)| format);
        let mut command = Command::new("ffmpeg");
        command.args(["-hide_banner", "-loglevel", "error", "-f", "yuv4mpegpipe", "-i", "pipe:0"]);
        command
            .args("-color_primaries bt709 -color_trc bt709 -colorspace bt709 -color_range tv -f".split(' '))
            .arg(format);
        if arguments.is_empty() && matches!(format, "mp4" | "mov") {
            command.args("-c:v libx264 -preset veryfast -crf 18 -pix_fmt yuv420p -movflags +faststart".split(' '));
        }
        command.args(arguments).arg("-y").arg(output);
        // Ctrl-C is for planecast to hear: ffmpeg is to end its file.
        #[cfg(unix)]
        std::os::unix::process::CommandExt::process_group(&mut command, 0);
        command.stdin(Stdio::piped()).stdout(Stdio::null()).stderr(Stdio::piped());
        let mut child = command.spawn().map_err(fault)?;
        let mut stderr = child.stderr.take().expect("piped");
        let said = std::thread::spawn(move || {
            let mut text = Vec::new();
            _ = stderr.read_to_end(&mut text);
            String::from_utf8_lossy(&text).into_owned()
        });
        let mut stdin = BufWriter::with_capacity(1 << 20, child.stdin.take().expect("piped"));
        // What is wrong is in what ffmpeg says.
        _ = y4m_head(&mut stdin, size[0], size[1], rate);
        Ok(Pipe { child, stdin, said })
    }

    pub fn frame(&mut self, yuv: &Yuv) -> io::Result<()> {
        y4m_frame(&mut self.stdin, yuv)
    }

    /// Waits for the end of the film.
    pub fn finish(self) -> Result<()> {
        let Pipe { mut child, stdin, said } = self;
        drop(stdin.into_inner());
        let status = child.wait().map_err(fault)?;
        let said = said.join().unwrap_or_default();
        if status.success() {
            return Ok(());
        }
        let lines: Vec<&str> = said.lines().map(str::trim).filter(|l| !l.is_empty()).take(3).collect();
        Err(fault(format!("ffmpeg ended with {status}: {}", lines.join("; "))))
    }
}
