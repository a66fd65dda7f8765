//! Tells the program which commit it is built from, where there is a git repository and git.

use std::path::Path;
use std::process::Command;

fn git(args: &[&str]) -> Option<String> {
    let output = Command::new("git").args(args).output().ok().filter(|o| o.status.success())?;
    Some(String::from_utf8(output.stdout).ok()?.trim().to_owned()).filter(|text| !text.is_empty())
}

fn main() {
    println!("cargo:rerun-if-changed=build.rs");
    // Not that of a repository around this one's copy.
    let own = git(&["ls-files", "--error-unmatch", "build.rs"]).is_some();
    let Some(commit) = git(&["rev-parse", "--short=9", "HEAD"]).filter(|_| own) else { return };
    println!("cargo:rustc-env=PLANECAST_COMMIT={commit}");
    // Of a release each commit; while developing only another branch, so that a commit compiles nothing again.
    let mut files = vec!["HEAD".to_owned()];
    if std::env::var("PROFILE").is_ok_and(|profile| profile == "release") {
        files.extend(git(&["symbolic-ref", "-q", "HEAD"]));
    }
    for file in files.iter().filter_map(|file| git(&["rev-parse", "--git-path", file])) {
        if Path::new(&file).exists() {
            println!("cargo:rerun-if-changed={file}");
        }
    }
}
