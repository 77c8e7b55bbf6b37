//! Single-sample spikes of a recording, counted as it passes: in blocks, by the rule that the identification repairs by.

use lacuna_estimation::filter::{SpikeRule, find_spikes};
use lacuna_identify::condition::{Conditioning, SPIKE_SHARE_POSITION, SPIKE_SHARE_TORQUE};
use lacuna_interfaces::{JointMeasured, MAX_JOINTS};

/// Samples that are judged at a time.
const BLOCK: usize = 1 << 16;
/// Samples at both ends of a block that the block beside it judges: a spike needs its surroundings.
const MARGIN: usize = 32;

/// Positions and torques of the block that is being filled.
pub struct Spikes {
    joints: usize,
    columns: Vec<Vec<f64>>,
    counts: [[u64; MAX_JOINTS]; 2],
    first: bool,
}

impl Spikes {
    /// Of a robot with so many joints.
    pub fn new(joints: usize) -> Self {
        let joints = joints.min(MAX_JOINTS);
        Self { joints, columns: vec![Vec::new(); 2 * joints], counts: [[0; MAX_JOINTS]; 2], first: true }
    }

    /// The next sample.
    pub fn saw(&mut self, m: &JointMeasured) {
        let values = m.q_rad.iter().take(self.joints).chain(m.tau_nm.iter().take(self.joints));
        self.columns.iter_mut().zip(values).for_each(|(column, value)| column.push(*value));
        if self.columns.first().is_some_and(|c| c.len() >= BLOCK) {
            self.judge(false);
        }
    }

    /// Counts what is in the block, all but a margin, and keeps what the next one needs.
    fn judge(&mut self, last: bool) {
        for (i, column) in self.columns.iter_mut().enumerate() {
            let (signal, joint) = (i / self.joints.max(1), i % self.joints.max(1));
            let share = if signal == 0 { SPIKE_SHARE_POSITION } else { SPIKE_SHARE_TORQUE };
            let found = find_spikes(column, &SpikeRule::of(column, share, Conditioning::default().spike_threshold));
            let from = if self.first { 0 } else { MARGIN };
            let to = if last { column.len() } else { column.len().saturating_sub(MARGIN) };
            let inside = found.iter().filter(|k| (from..to).contains(*k)).count() as u64;
            if let Some(count) = self.counts.get_mut(signal).and_then(|list| list.get_mut(joint)) {
                *count += inside;
            }
            column.drain(..column.len().saturating_sub(2 * MARGIN));
        }
        self.first = false;
    }

    /// Spikes of position and of torque, joint by joint.
    pub fn finish(mut self) -> Vec<[u64; 2]> {
        self.judge(true);
        let [q, tau] = self.counts;
        q.into_iter().zip(tau).take(self.joints).map(|(q, tau)| [q, tau]).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn spikes_are_counted_once_wherever_blocks_meet() {
        let mut spikes = Spikes::new(2);
        let at = [5, 20_000, BLOCK - MARGIN - 4, BLOCK - MARGIN, BLOCK - 3, BLOCK + 2, 2 * BLOCK - 90, 2 * BLOCK + 500];
        for k in 0..2 * BLOCK + 1000 {
            let mut m = JointMeasured::default();
            let wave = (k as f64 * 0.01).sin();
            m.q_rad[0] = wave + if at.contains(&k) { 0.7 } else { 0.0 };
            m.tau_nm[1] = 3.0 * wave + if k == 777 { -40.0 } else { 0.0 };
            spikes.saw(&m);
        }
        assert_eq!(spikes.finish(), [[at.len() as u64, 0], [0, 1]]);
    }
}
