//! Reads the chain of named joints out of a URDF.

use super::chain::{Placement, Segment};
use lacuna_interfaces::BadInput;

/// Segments and tip frame of the chain of `joints` in the URDF `text`.
///
/// # Errors
/// [`BadInput`].
pub fn read(text: &str, joints: &[String]) -> Result<(Vec<Segment>, Placement), BadInput> {
    let _ = (text, joints);
    Err(BadInput::new("urdf: not read yet"))
}
