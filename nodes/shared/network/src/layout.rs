//! Names, shapes and widths of the networks' weights, which the ONNX export and the networks in burn share.

pub mod detector;
pub mod raft;
pub mod refiner;
