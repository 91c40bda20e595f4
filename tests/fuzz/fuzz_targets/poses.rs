#![no_main]
libfuzzer_sys::fuzz_target!(|bytes: &[u8]| pseudoflow_fuzz::poses(bytes));
