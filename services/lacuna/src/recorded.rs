//! What a graph recorded, read back from its MCAP: the demo's tables come from the file, not from memory.

use lacuna_recording::ros::cdr::Cursor;
use lacuna_stage::Failure;
use std::collections::HashMap;
use std::path::Path;

/// Per-axis values over time.
#[derive(Debug, Default)]
pub struct Series {
    /// Time [s].
    pub t_s: Vec<f64>,
    /// `values[sample][axis]`.
    pub values: Vec<Vec<f64>>,
}

/// Streams of a recording.
#[derive(Debug, Default)]
pub struct Recorded {
    /// Effort of every JointState topic, by topic.
    pub effort: HashMap<String, Series>,
    /// Position of `/smoothed` [rad].
    pub position: Series,
    /// Velocity of `/smoothed` [rad/s].
    pub velocity: Series,
    /// Mass, its standard deviation [kg] and 1 where the motion supports it, from `/payload`.
    pub payload: Series,
}

impl Recorded {
    /// Reads a recording whole.
    pub fn read(path: &Path) -> Result<Self, Failure> {
        let fail = |e: &dyn std::fmt::Display| Failure::run(format!("{}: cannot be read back: {e}", path.display()));
        let bytes = std::fs::read(path).map_err(|e| fail(&e))?;
        let mut recorded = Self::default();
        for message in mcap::MessageStream::new(&bytes).map_err(|e| fail(&e))? {
            let message = message.map_err(|e| fail(&e))?;
            let topic = message.channel.topic.as_str();
            let schema = message.channel.schema.as_ref().map_or("", |s| s.name.as_str());
            let taken = match schema {
                "sensor_msgs/msg/JointState" => recorded.joint_state(topic, &message.data),
                "lacuna_msgs/msg/Payload" => recorded.payload(&message.data),
                _ => Some(()),
            };
            taken.ok_or_else(|| fail(&format_args!("a message of {topic} is cut")))?;
        }
        Ok(recorded)
    }

    fn joint_state(&mut self, topic: &str, data: &[u8]) -> Option<()> {
        let mut cursor = Cursor::new(data)?;
        let t_s = cursor.header()? as f64 / 1e9;
        cursor.strings()?;
        let mut list = || -> Option<Vec<f64>> {
            let numbers = cursor.numbers()?;
            (0..numbers.len()).map(|i| numbers.get(i)).collect()
        };
        let (position, velocity, effort) = (list()?, list()?, list()?);
        if topic == "/smoothed" {
            self.position.push(t_s, position);
            self.velocity.push(t_s, velocity);
        }
        if !effort.is_empty() {
            self.effort.entry(topic.to_owned()).or_default().push(t_s, effort);
        }
        Some(())
    }

    fn payload(&mut self, data: &[u8]) -> Option<()> {
        let mut cursor = Cursor::new(data)?;
        let t_s = cursor.header()? as f64 / 1e9;
        let (mass, sd, excited) = (cursor.f64()?, cursor.f64()?, f64::from(cursor.u8()?));
        self.payload.push(t_s, vec![mass, sd, excited]);
        Some(())
    }

    /// Effort of a topic.
    pub fn effort(&self, topic: &str) -> Result<&Series, Failure> {
        self.effort.get(topic).ok_or_else(|| Failure::run(format!("the recording has no topic {topic}")))
    }
}

impl Series {
    fn push(&mut self, t_s: f64, values: Vec<f64>) {
        self.t_s.push(t_s);
        self.values.push(values);
    }
}
