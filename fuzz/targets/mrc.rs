#![no_main]
use planecast_encoder::source::Format;
libfuzzer_sys::fuzz_target!(|bytes: &[u8]| planecast_fuzz::import(Format::Mrc, bytes));
