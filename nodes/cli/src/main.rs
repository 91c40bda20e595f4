//! The one binary, `pseudoflow`.
fn main() {}
