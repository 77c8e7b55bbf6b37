//! What a link is told, and what the tunnel is told in turn.

use lacuna_interfaces::BadInput;
use lacuna_stage::Clocks;
use serde::Deserialize;
use std::path::PathBuf;

/// The node's `config` table.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Config {
    /// Message that the receiver gets (the sender sees it): `JointMeasured`, …
    pub message: Option<String>,
    /// Address and port to listen on, as `tcp/0.0.0.0:7447`; one machine of the two must listen.
    pub listen: String,
    /// Address and port of the other machine, as `tcp/192.168.1.7:7447`.
    pub connect: String,
    /// Executable of the tunnel: a name on PATH, or a path.
    pub tunnel: PathBuf,
    /// How often the tunnel looks for samples [ms].
    pub poll_ms: u32,
    /// How long the sender lets the machines find each other before the stream begins [s].
    pub settle_s: f64,
    /// How the clocks of the machines go together: `apart`, `one` (both ends on one machine) or `synchronised`.
    pub clocks: Clocks,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            message: None,
            listen: String::new(),
            connect: String::new(),
            tunnel: PathBuf::from("iox2-link-tunnel-zenoh"),
            poll_ms: 1,
            settle_s: 3.0,
            clocks: Clocks::Apart,
        }
    }
}

impl Config {
    /// Checks the values.
    ///
    /// # Errors
    /// [`BadInput`] with the key, what was found and what was expected.
    pub fn check(&self) -> Result<(), BadInput> {
        if self.listen.is_empty() && self.connect.is_empty() {
            return Err(BadInput::new(
                "link: found neither listen nor connect; expected one, as in listen = \"tcp/0.0.0.0:7447\"",
            ));
        }
        for (key, endpoint) in [("listen", &self.listen), ("connect", &self.connect)] {
            let port =
                endpoint.strip_prefix("tcp/").and_then(|e| e.rsplit_once(':')).map(|(_, port)| port.parse::<u16>());
            if !(endpoint.is_empty() || matches!(port, Some(Ok(1..)))) {
                return Err(BadInput::new(format!("{key}: found \"{endpoint}\"; expected tcp/ADDRESS:PORT")));
            }
        }
        if !(1..=1000).contains(&self.poll_ms) {
            return Err(BadInput::new(format!("poll_ms: found {}; expected 1 to 1000", self.poll_ms)));
        }
        // The supervisor gives every node fifteen seconds to be ready.
        if !(self.settle_s.is_finite() && (0.0..=12.0).contains(&self.settle_s)) {
            return Err(BadInput::new(format!("settle_s: found {}; expected 0 to 12", self.settle_s)));
        }
        Ok(())
    }

    /// The tunnel's zenoh configuration: these two machines and nobody else. Its own default would join every tunnel on
    /// the network.
    pub fn zenoh(&self) -> String {
        let list = |endpoint: &str| if endpoint.is_empty() { vec![] } else { vec![endpoint.to_owned()] };
        let text = serde_json::json!({
            "mode": "peer",
            "listen": { "endpoints": list(&self.listen) },
            "connect": { "endpoints": list(&self.connect), "timeout_ms": -1, "exit_on_failure": false },
            "scouting": { "multicast": { "enabled": false }, "gossip": { "enabled": false } },
        });
        format!("{text:#}\n")
    }
}

/// The run's domain for the tunnel: what a reader cannot take is dropped, since a tunnel that waits for its own reader
/// would wait for ever.
pub fn tunnel_domain(domain: &str) -> String {
    domain.replace("backpressure-strategy = \"RetryUntilDelivered\"", "backpressure-strategy = \"DiscardData\"")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn endpoints_are_checked() {
        let check = |text: &str| toml::from_str::<Config>(text).unwrap().check();
        assert!(check("listen = \"tcp/0.0.0.0:7447\"").is_ok());
        assert!(check("connect = \"tcp/[fe80::1]:7447\"").is_ok());
        for (text, expect) in [
            ("", "neither"),
            ("listen = \"0.0.0.0:7447\"", "tcp/ADDRESS:PORT"),
            ("listen = \"tcp/0.0.0.0\"", "tcp/ADDRESS:PORT"),
            ("connect = \"tcp/robot:0\"", "tcp/ADDRESS:PORT"),
            ("connect = \"tcp/robot:7447\"\npoll_ms = 0", "poll_ms"),
            ("connect = \"tcp/robot:7447\"\nsettle_s = nan", "settle_s"),
        ] {
            assert!(check(text).unwrap_err().what.contains(expect), "{text}");
        }
        assert!(toml::from_str::<Config>("port = 3").is_err());
    }

    #[test]
    fn the_tunnel_meets_nobody_else() {
        let config: Config = toml::from_str("connect = \"tcp/robot:7447\"").unwrap();
        let zenoh: serde_json::Value = serde_json::from_str(&config.zenoh()).unwrap();
        assert_eq!(zenoh["connect"]["endpoints"], serde_json::json!(["tcp/robot:7447"]));
        assert_eq!(zenoh["listen"]["endpoints"], serde_json::json!([]));
        assert_eq!(zenoh["scouting"]["multicast"]["enabled"], false);
    }
}
