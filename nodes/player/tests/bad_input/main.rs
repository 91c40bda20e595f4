//! What cannot be played is refused when the player is made, before any node has written anything, with one error
//! that names file, field and remedy.

mod bags;
mod poses;
mod recordings;
mod scenes;
