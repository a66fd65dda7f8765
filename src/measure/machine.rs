//! What a measurement was made with: the machine and this very program.

use serde::Serialize;
use std::fmt;

/// Everything that a figure depends on beside its own configuration.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Machine {
    /// Processor, as the operating system names it.
    pub cpu: String,
    /// Threads that draw.
    pub threads: usize,
    /// Adapter and driver, where one is used.
    pub gpu: Option<String>,
    pub os: &'static str,
    /// Version of the package, and the xxh3 of the program's file: it changes with each build that does.
    pub program: String,
    /// What was typed.
    pub command: String,
}

impl Machine {
    pub fn new(gpu: Option<String>) -> Machine {
        let command: Vec<String> = std::env::args_os().map(|a| quoted(&a.to_string_lossy())).collect();
        Machine {
            cpu: cpu().unwrap_or_else(|| std::env::consts::ARCH.into()),
            threads: rayon::current_num_threads(),
            gpu,
            os: std::env::consts::OS,
            program: program(),
            // The folder that the program lies in is nobody's business.
            command: ["planecast".to_owned()]
                .into_iter()
                .chain(command.into_iter().skip(1))
                .collect::<Vec<_>>()
                .join(" "),
        }
    }
}

impl fmt::Display for Machine {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let threads = if self.threads == 1 { "1 thread".into() } else { format!("{} threads", self.threads) };
        write!(f, "{}, {threads}, {}", self.cpu, self.os)?;
        if let Some(gpu) = &self.gpu {
            write!(f, ", {gpu}")?;
        }
        write!(f, "; planecast {}", self.program)
    }
}

/// Version and content of the running program.
pub fn program() -> String {
    let version = env!("CARGO_PKG_VERSION");
    let content = std::env::current_exe().and_then(std::fs::read);
    match content {
        Ok(bytes) => format!("{version} ({:016x})", xxhash_rust::xxh3::xxh3_64(&bytes)),
        Err(_) => version.into(),
    }
}

fn cpu() -> Option<String> {
    let text = std::fs::read_to_string("/proc/cpuinfo").ok()?;
    let line = text.lines().find(|l| l.starts_with("model name"))?;
    Some(line.split_once(':')?.1.trim().into())
}

/// An argument as a shell takes it.
fn quoted(argument: &str) -> String {
    let plain = |c: char| c.is_alphanumeric() || "-_./,:=%+@".contains(c);
    if !argument.is_empty() && argument.chars().all(plain) {
        argument.into()
    } else {
        format!("'{}'", argument.replace('\'', "'\\''"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn machine_names_processor_program_and_command() {
        let machine = Machine::new(Some("adapter".into()));
        assert!(!machine.cpu.is_empty() && machine.threads > 0 && machine.command.starts_with("planecast"));
        assert!(machine.to_string().contains(&format!("adapter; planecast {}", env!("CARGO_PKG_VERSION"))));
        assert_eq!(machine.program, program());
        assert_eq!((quoted("a=1%"), quoted("it's")), ("a=1%".to_owned(), "'it'\\''s'".to_owned()));
    }
}
