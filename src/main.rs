//! The `planecast` command.

use std::process::ExitCode;

#[global_allocator]
static ALLOCATOR: planecast_encoder::store::guard::Allocator = planecast_encoder::store::guard::Allocator;

fn main() -> ExitCode {
    // Faults are told in plain words. The library that says that memory is out looks here, whatever the program has to say.
    // SAFETY: no other thread has been started that could read the environment meanwhile.
    unsafe { std::env::set_var("RUST_BACKTRACE", "0") };
    // Without a display Mesa's device-select layer, which picks among adapters as this program does itself, only
    // complains on stderr.
    let set = |name| std::env::var_os(name).is_some();
    if !set("DISPLAY") && !set("WAYLAND_DISPLAY") && !set("NODEVICE_SELECT") {
        // SAFETY: no other thread has been started that could read the environment meanwhile.
        unsafe { std::env::set_var("NODEVICE_SELECT", "1") };
    }
    // A fault of the program itself is told in one line too, and ends it wherever it happens.
    std::panic::set_hook(Box::new(|panic| {
        let place = panic.location().map(|l| format!(" at {}:{}", l.file(), l.line())).unwrap_or_default();
        let what = panic.payload_as_str().unwrap_or("unknown").replace('\n', " ");
        planecast_encoder::store::guard::last_word();
        // Threads are asked for in libraries, too, which take them for granted.
        if planecast_encoder::store::guard::is_short_of_memory()
            || what.contains("spawn thread")
            || what.contains("ThreadPool")
        {
            planecast_encoder::say!(
                "planecast: out of memory: {what}; raise the system's limit (ulimit -v), or ask for less (--memory, --size, --threads)"
            );
            planecast_encoder::store::guard::leave(1);
        }
        planecast_encoder::say!("planecast: a fault in the program itself{place}: {what}; please report it");
        std::process::exit(1);
    }));
    planecast::cli::run(std::env::args_os())
}
