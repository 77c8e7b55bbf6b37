//! EtherCAT traffic as joint signals: frames and datagrams, the master's ENI file, and the cycles put together.
//!
//! Written after the frame layout of ETG.1000.4 (frames, datagrams, working counter) and the file layout of ETG.2100
//! (EtherCAT network information). Pure: bytes in, samples out; where the bytes come from (a capture, a socket) is the
//! caller's business.

mod eni;
mod frame;
mod image;

pub use eni::resolve;
pub use frame::{Command, Cut, Datagram, Datagrams, Frame};
pub use image::{Cycles, Scales};
