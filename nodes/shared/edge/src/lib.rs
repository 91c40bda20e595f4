//! What bridge, player and recorder share, so that a live camera and its recording mean the same: the names of an object
//! set ([`Catalogue`]), cameras as their drivers give them ([`camera`]), the pixels of their images ([`pixels`]). No middleware
//! here: messages are plain data.

pub mod camera;
mod objects;
pub mod pixels;
mod rectangles;

pub use objects::{Catalogue, CatalogueError, naming_of};
pub use rectangles::{RectangleError, rectangle_of};
