//! `planecast-encode`: the commands of `planecast` that need no renderer.

use std::process::ExitCode;

use clap::Parser;
use planecast_encoder::cli;

/// Make, read back and look into .pcast scenes
#[derive(clap::Parser)]
#[command(name = "planecast-encode", version)]
enum Command {
    Encode(cli::EncodeArgs),
    Merge(cli::MergeArgs),
    World(cli::WorldArgs),
    Verify(cli::VerifyArgs),
    Decode(cli::DecodeArgs),
    Info(cli::InfoArgs),
    Query(cli::QueryArgs),
}

#[global_allocator]
static ALLOCATOR: planecast_encoder::store::guard::Allocator = planecast_encoder::store::guard::Allocator;

fn main() -> ExitCode {
    // Faults are told in plain words. The library that says that memory is out looks here, whatever the program has to say.
    // SAFETY: no other thread has been started that could read the environment meanwhile.
    unsafe { std::env::set_var("RUST_BACKTRACE", "0") };
    planecast_encoder::store::guard::explain_lost_files();
    let done = match Command::parse() {
        Command::Encode(args) => args.run(),
        Command::Merge(args) => args.run(),
        Command::World(args) => args.run(),
        Command::Verify(args) => args.run(),
        Command::Decode(args) => args.run(),
        Command::Info(args) => args.run(),
        Command::Query(args) => args.run(),
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            planecast_encoder::store::guard::last_word();
            planecast_encoder::say!("planecast-encode: {error}");
            cli::exit_status(&error).into()
        }
    }
}
