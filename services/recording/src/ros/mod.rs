//! ROS 2 messages without ROS: their definitions, their CDR encoding, and the bag folder around a file.

pub mod bag;
pub mod cdr;
pub mod definition;
pub(crate) mod joint_state;
pub mod schema;
