//! Texture anchored on keyframes: patches whose depth is that of the object's pose there, found again in a frame.
//!
//! A patch is warped as its plane moves (Shi and Tomasi 1994), then shifted by inverse-compositional steps from coarse to fine
//! (Baker and Matthews 2004; Bouguet 2001), with gain and offset of its brightness free.

mod keyframe;
mod patch;
mod pyramid;
mod term;

pub(crate) use keyframe::{Keyframe, Maker};
pub(crate) use pyramid::Pyramid;
pub(crate) use term::{TextureTerm, matches};
