//! The `planecast` command.

use std::process::ExitCode;

fn main() -> ExitCode {
    // A fault of the program itself is told in one line too, and ends it wherever it happens.
    std::panic::set_hook(Box::new(|panic| {
        let place = panic.location().map(|l| format!(" at {}:{}", l.file(), l.line())).unwrap_or_default();
        let what = panic.payload_as_str().unwrap_or("unknown").replace('\n', " ");
        eprintln!("planecast: a fault in the program itself{place}: {what}; please report it");
        std::process::exit(1);
    }));
    planecast::cli::run(std::env::args_os())
}
