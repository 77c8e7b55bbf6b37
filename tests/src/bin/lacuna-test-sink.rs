//! A sink that counts, can be slow, and says how many samples of each topic it saw and their last sequence.

use lacuna_interfaces::BadInput;
use lacuna_stage::{AnyMessage, Sink, SinkContext, run_sink};
use serde::Deserialize;
use std::collections::BTreeMap;
use std::process::ExitCode;
use std::time::Duration;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Config {
    /// Pause after this many samples …
    #[serde(default)]
    pause_every: u64,
    /// … for so long [µs].
    #[serde(default)]
    pause_us: u64,
}

struct Counter {
    config: Config,
    seen: BTreeMap<String, (u64, u64)>,
    total: u64,
}

impl Sink for Counter {
    type Config = Config;

    fn new(config: Config, context: &SinkContext<'_>) -> Result<Self, BadInput> {
        let seen = context.topics.iter().map(|(topic, _)| (topic.clone(), (0, 0))).collect();
        Ok(Self { config, seen, total: 0 })
    }

    fn take(&mut self, topic: &str, message: AnyMessage<'_>, _missing: u64) -> Result<(), String> {
        let entry = self.seen.get_mut(topic).ok_or("a topic that was not announced")?;
        entry.0 += 1;
        entry.1 = message.header().seq;
        self.total += 1;
        if self.config.pause_every > 0 && self.total.is_multiple_of(self.config.pause_every) {
            std::thread::sleep(Duration::from_micros(self.config.pause_us));
        }
        Ok(())
    }

    fn idle(&mut self) {}

    fn finish(self, complete: bool) -> Result<serde_json::Value, String> {
        Ok(serde_json::json!({ "complete": complete, "seen": self.seen }))
    }
}

fn main() -> ExitCode {
    run_sink::<Counter>()
}
