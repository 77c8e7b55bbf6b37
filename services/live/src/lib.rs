//! The live view: what the graph measures and computes, thinned out, for viewers on the network.
//!
//! Viewers (Foxglove, Lichtblick, anything that speaks `foxglove.sdk.v1`) see the topics that a recording of the graph
//! holds, byte for byte the same messages: a layout made for one fits the other. A person needs a few dozen samples a
//! second, a robot makes thousands: time is cut into slots of 1/`rate_hz`, and of each stream the first sample of a
//! slot is shown. All streams have the same slots, so what is shown of them belongs together; a change of an alarm
//! is shown at once.
//!
//! This library holds what can be said without a network: the configuration and the choice of samples.

use lacuna_interfaces::{BadInput, Header};
use serde::Deserialize;
use std::net::IpAddr;

/// The node's `config` table. Everything has a default.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Config {
    /// Address to listen on. Loopback: viewers on this machine alone; whoever reaches another address can read along.
    pub address: IpAddr,
    /// Port to listen on; 0 for any that is free (the log says which).
    pub port: u16,
    /// Samples of each stream that are shown per second of the measurement.
    pub rate_hz: f64,
    /// Messages that a slow viewer may lag behind; beyond them it loses the oldest.
    pub backlog: usize,
}

impl Default for Config {
    fn default() -> Self {
        Self { address: IpAddr::from([127, 0, 0, 1]), port: 8765, rate_hz: 50.0, backlog: 1024 }
    }
}

impl Config {
    /// Checks the values.
    ///
    /// # Errors
    /// [`BadInput`] with the key, what was found and what was expected.
    pub fn check(&self) -> Result<(), BadInput> {
        if !(self.rate_hz.is_finite() && (0.01..=100_000.0).contains(&self.rate_hz)) {
            return Err(BadInput::new(format!("rate_hz: found {}; expected 0.01 to 100000", self.rate_hz)));
        }
        if !(16..=1_000_000).contains(&self.backlog) {
            return Err(BadInput::new(format!("backlog: found {}; expected 16 to 1000000 messages", self.backlog)));
        }
        Ok(())
    }
}

/// Chooses the samples of one stream that are shown.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Thinner {
    slot_ns: i64,
    last: Option<(i64, u32)>,
    /// Samples shown so far.
    pub shown: u64,
    /// Samples passed over so far.
    pub passed_over: u64,
}

impl Thinner {
    /// One for `rate_hz` samples per second.
    pub fn new(rate_hz: f64) -> Self {
        // A cast from f64 saturates; 0.01 Hz and more are far from the ends.
        Self { slot_ns: ((1e9 / rate_hz) as i64).max(1), last: None, shown: 0, passed_over: 0 }
    }

    /// Whether a sample is shown; `alarm` are the alarm bits it carries, 0 for messages without any.
    pub fn shows(&mut self, header: &Header, alarm: u32) -> bool {
        let now = (header.stamp_ns.div_euclid(self.slot_ns), alarm);
        let shows = self.last != Some(now);
        if shows {
            self.last = Some(now);
            self.shown += 1;
        } else {
            self.passed_over += 1;
        }
        shows
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(stamp_ns: i64) -> Header {
        Header { stamp_ns, ..Header::default() }
    }

    #[test]
    fn one_sample_a_slot_and_the_same_for_all_streams() {
        // 1 kHz and 333 Hz streams of the same measurement, from a stamp before zero on.
        let (mut quick, mut slow) = (Thinner::new(50.0), Thinner::new(50.0));
        let shown = |t: &mut Thinner, step: i64| -> Vec<i64> {
            (-500..1500).step_by(step as usize).map(|ms| ms * 1_000_000).filter(|&ns| t.shows(&at(ns), 0)).collect()
        };
        let first = shown(&mut quick, 1);
        assert_eq!(first.len(), 100);
        assert!(first.iter().all(|ns| ns % 20_000_000 == 0), "{first:?}");
        assert_eq!((quick.shown, quick.passed_over), (100, 1900));
        assert_eq!(shown(&mut slow, 4).len(), 100);
    }

    #[test]
    fn a_change_of_an_alarm_is_shown_at_once() {
        let mut t = Thinner::new(1.0);
        let seen: Vec<bool> = [(0, 0), (1, 0), (2, 1), (3, 1), (4, 0), (5, 0)]
            .map(|(ms, alarm)| t.shows(&at(ms * 1_000_000), alarm))
            .to_vec();
        assert_eq!(seen, [true, false, true, false, true, false]);
    }

    #[test]
    fn any_stamp_is_taken() {
        let mut t = Thinner::new(100_000.0);
        for ns in [i64::MIN, 0, i64::MAX, -1, i64::MIN] {
            assert!(t.shows(&at(ns), 0), "{ns}");
        }
    }

    #[test]
    fn config_is_checked() {
        let parse = |text: &str| toml::from_str::<Config>(text);
        let config = parse("").unwrap();
        assert!(config.address.is_loopback() && config.check().is_ok());
        for (text, expect) in [("rate_hz = 0.0", "rate_hz"), ("rate_hz = nan", "rate_hz"), ("backlog = 1", "backlog")] {
            assert!(parse(text).unwrap().check().unwrap_err().what.contains(expect), "{text}");
        }
        for text in ["address = \"localhost\"", "port = 70000", "rate = 3"] {
            assert!(parse(text).is_err(), "{text}");
        }
    }
}
