//! A source of synthetic motion: three joints on sines, as many samples as asked for.

use lacuna_interfaces::{BadInput, JointMeasured};
use lacuna_stage::{Next, Source, SourceContext, run_source};
use serde::Deserialize;
use std::process::ExitCode;
use std::time::Duration;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Config {
    /// Number of samples.
    samples: u64,
    /// Sample rate of the motion [Hz].
    rate_hz: f64,
    /// Send at that rate instead of as fast as the graph accepts.
    #[serde(default)]
    paced: bool,
    /// Behave like a tap: samples come by themselves at that rate, numbered from 1 in every process.
    #[serde(default)]
    live: bool,
}

struct Sines {
    config: Config,
    joints: usize,
    next: u64,
}

impl Source for Sines {
    type Config = Config;
    type Output = JointMeasured;

    fn new(config: Config, context: &SourceContext<'_>) -> Result<Self, BadInput> {
        if !(config.rate_hz.is_finite() && config.rate_hz > 0.0) {
            return Err(BadInput::new(format!("rate_hz: found {}; expected a positive number", config.rate_hz)));
        }
        Ok(Self { config, joints: context.robot.joint_count(), next: 1 })
    }

    fn next_sample(&mut self) -> Result<Next<JointMeasured>, BadInput> {
        if self.next > self.config.samples {
            return Ok(Next::End);
        }
        if self.config.live {
            std::thread::sleep(Duration::from_secs_f64(1.0 / self.config.rate_hz));
        }
        let t = (self.next - 1) as f64 / self.config.rate_hz;
        let mut m = JointMeasured::default();
        m.header.seq = self.next;
        m.header.stamp_ns = (t * 1e9).round() as i64;
        m.header.joints = self.joints as u32;
        for i in 0..self.joints {
            let (f, phase) = (1.0 + 0.3 * i as f64, 0.7 * i as f64);
            m.q_rad[i] = 0.4 + 0.3 * (std::f64::consts::TAU * f * t + phase).sin();
            m.tau_nm[i] = (std::f64::consts::TAU * f * t).cos();
        }
        for i in 0..m.temperature_degc.len() {
            m.temperature_degc[i] = f64::NAN;
            m.link_q_rad[i] = f64::NAN;
            m.link_tau_nm[i] = f64::NAN;
        }
        self.next += 1;
        Ok(Next::Sample(m))
    }

    fn is_live(&self) -> bool {
        self.config.live
    }

    fn due_ns(&self, sample: &JointMeasured) -> Option<u64> {
        self.config.paced.then_some(sample.header.stamp_ns as u64)
    }

    fn fraction(&self) -> Option<f64> {
        Some((self.next - 1) as f64 / self.config.samples.max(1) as f64)
    }

    fn report(&self) -> serde_json::Value {
        serde_json::json!({ "samples": self.next - 1 })
    }
}

fn main() -> ExitCode {
    run_source::<Sines>()
}
