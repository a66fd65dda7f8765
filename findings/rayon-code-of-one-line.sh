#!/usr/bin/env bash
# rayon 1.12.0 (rustc 1.95.0): one line, `(0..n).into_par_iter().map(work).collect::<Result<Vec<_>, _>>()`, is 11 times the code of
# the same line without `into_par_`: 449 functions and 17,420 lines of LLVM IR before any optimisation, beside 45 and 1,609. The next
# such line in the same crate adds 11,019 lines and 233 functions: what splits a range, joins, steals and catches panics is generic
# over the closure and compiled anew, also for each type of a generic function around it.
#
# It matters because it looks like one line. In planecast's encoder 758,000 of 3,135,000 lines of IR were this, half of them from six
# such lines within generic functions; a loop over `&dyn Fn(usize)`, compiled once, left 254,000.
#
# Expected before it was run: two or three times, and the parts that do not see the values compiled once.
# Seen, lines of IR (functions): serial 1,609 (45), one 17,420 (449), two of them 28,439 (682).
# Exits with a status other than 0 once that changes by more than a quarter.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
mkdir src
cat > Cargo.toml <<'TOML'
[package]
name = "lines"
version = "0.0.0"
edition = "2021"
[features]
serial = []
one = []
two = ["one"]
[dependencies]
rayon = "=1.12.0"
TOML
cat > src/lib.rs <<'RUST'
#![allow(unused_imports)]
use rayon::prelude::*;
pub type Work = fn(usize) -> Result<u64, String>;
#[cfg(feature = "serial")]
pub fn serial(n: usize, work: Work) -> Result<Vec<u64>, String> {
    (0..n).map(|i| work(i)).collect()
}
#[cfg(feature = "one")]
pub fn one(n: usize, work: Work) -> Result<Vec<u64>, String> {
    (0..n).into_par_iter().map(|i| work(i)).collect()
}
#[cfg(feature = "two")]
pub fn two(n: usize, work: Work) -> Result<Vec<u64>, String> {
    (0..n).into_par_iter().map(|i| work(n - i)).collect()
}
RUST
count() {
    cargo rustc --quiet --features "$1" -- --emit=llvm-ir -C codegen-units=1 -C no-prepopulate-passes -C debuginfo=0
    local ir
    ir=$(ls -t target/debug/deps/lines-*.ll | head -1)
    wc -l < "$ir"
    echo "$1: $(wc -l < "$ir") lines, $(grep -c '^define' "$ir") functions" >&2
}
serial=$(count serial) one=$(count one) two=$(count two)
near() { [ "$(($1 * 4))" -gt "$(($2 * 3))" ] && [ "$(($1 * 3))" -lt "$(($2 * 4))" ]; }
near "$serial" 1609 && near "$one" 17420 && near "$two" 28439
