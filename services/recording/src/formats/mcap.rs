//! MCAP with ROS 2 JointState messages.

use super::{Format, Request};
use crate::sample::RawReader;
use lacuna_interfaces::BadInput;

/// The registry's line.
pub const FORMAT: Format = Format { name: "mcap", extensions: &["mcap"], sniff: |b| b.starts_with(mcap::MAGIC), open };

fn open(request: &Request<'_>) -> Result<Box<dyn RawReader>, BadInput> {
    Err(BadInput::new("MCAP reading is being written").in_file(request.path))
}
