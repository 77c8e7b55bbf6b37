//! One joint: blocks, their noise, the test.

use crate::region::{Map, Place};

/// Blocks whose size is beyond this many standard deviations do not make the noise estimate grow further.
const CLIP: f64 = 3.0;
/// A block beyond this many standard deviations is as bad as one there.
const BEYOND: f64 = 1e6;
/// Weight of the model file's noise against measured blocks, in blocks.
const PRIOR_BLOCKS: f64 = 20.0;
/// Classes of acceleration, each twice the one before; the first ends at `FIRST_CLASS`.
const CLASSES: usize = 8;
/// Upper end of the first class [rad/s²].
const FIRST_CLASS: f64 = 1.0;
/// Largest correlation of successive blocks that is believed.
const MAX_CORRELATION: f64 = 0.95;
/// Evidence is held at this many thresholds, so that an alarm can end.
const CEILING: f64 = 1.25;
/// Share of the threshold at which an alarm ends.
const CLEAR: f64 = 0.5;

/// Constants of the test.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Test {
    /// Time of sliding that makes a block [s].
    pub block_s: f64,
    /// Growth of the residual that is found quickest.
    pub growth: f64,
    /// Evidence of an alarm [nats].
    pub threshold: f64,
    /// Blocks that the noise is learnt over.
    pub memory: f64,
    /// Share of the model torque that the model may be wrong by.
    pub model_error: f64,
}

impl Test {
    /// log-likelihood ratio of a standardised block: `growth` times the noise against the noise.
    fn evidence(&self, z: f64) -> f64 {
        0.5 * (1.0 - 1.0 / (self.growth * self.growth)) * z * z - self.growth.ln()
    }
}

/// One sample of a sliding joint.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Slide {
    pub stamp_ns: i64,
    pub dt_s: f64,
    pub q_rad: f64,
    pub qd_rad_s: f64,
    pub qdd_rad_s2: f64,
    pub load_nm: f64,
    pub residual_nm: f64,
}

/// Noise of block means at one class of acceleration.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Noise {
    variance: f64,
    weight: f64,
}

/// Sums of the block under way.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
struct Block {
    time_s: f64,
    count: f64,
    residual_nm: f64,
    load_nm2: f64,
    acceleration2: f64,
}

/// One joint under watch.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Watch {
    /// Standard deviation of the residual in the model file [Nm]; the block's may not exceed it.
    sd_nm: f64,
    block: Block,
    /// The block before in standard deviations, if this one follows it without a break.
    previous: Option<f64>,
    /// Mean of the last complete block, and the standard deviation it may have [Nm].
    pub last_nm: f64,
    pub last_sd_nm: f64,
    noise: [Noise; CLASSES],
    /// Correlation of successive blocks, variance of what a block brings anew, and the weight of both.
    correlation: f64,
    new_variance: f64,
    succession_weight: f64,
    /// Samples that a block usually has.
    samples: f64,
    evidence: f64,
    /// Onset of the present evidence [ns].
    pub since_ns: i64,
    /// Under alarm.
    pub alarm: bool,
    map: Map,
    /// Where, kept up to date under an alarm.
    pub place: Place,
}

impl Watch {
    pub fn new(sd_nm: f64) -> Self {
        Self {
            sd_nm,
            block: Block::default(),
            previous: None,
            last_nm: 0.0,
            last_sd_nm: sd_nm,
            noise: [Noise { variance: sd_nm * sd_nm, weight: PRIOR_BLOCKS }; CLASSES],
            correlation: 0.0,
            new_variance: 1.0,
            succession_weight: PRIOR_BLOCKS,
            samples: 0.0,
            evidence: 0.0,
            since_ns: 0,
            alarm: false,
            map: Map::new(),
            place: (0, 0.0, 0.0),
        }
    }

    /// Evidence as a share of the threshold.
    pub fn score(&self, test: &Test) -> f64 {
        self.evidence / test.threshold
    }

    /// The stretch of sliding ends; the next block does not follow the last one.
    pub fn pause(&mut self) {
        self.previous = None;
    }

    /// A gap or a restart: what was begun is dropped, what was learnt stays.
    pub fn break_off(&mut self) {
        self.block = Block::default();
        self.previous = None;
        self.calm();
    }

    fn calm(&mut self) {
        self.evidence = 0.0;
        self.alarm = false;
        self.map.clear();
    }

    #[inline]
    pub fn take(&mut self, s: &Slide, test: &Test) {
        let b = &mut self.block;
        if b.count == 0.0 && self.evidence == 0.0 {
            self.since_ns = s.stamp_ns;
        }
        b.time_s += s.dt_s;
        b.count += 1.0;
        b.residual_nm += s.residual_nm;
        b.load_nm2 += s.load_nm * s.load_nm;
        b.acceleration2 += s.qdd_rad_s2 * s.qdd_rad_s2;
        self.map.add(s.qd_rad_s, s.q_rad, s.load_nm, s.residual_nm);
        if self.block.time_s >= test.block_s {
            self.complete(test);
        }
    }

    fn complete(&mut self, test: &Test) {
        let b = std::mem::take(&mut self.block);
        let mean = b.residual_nm / b.count;
        self.samples += (b.count - self.samples) * if self.samples == 0.0 { 1.0 } else { 0.05 };
        let class = class_of((b.acceleration2 / b.count).sqrt());
        let allowed = self.noise[class].variance + test.model_error * test.model_error * b.load_nm2 / b.count;
        let sd = allowed.max(f64::MIN_POSITIVE).sqrt();
        (self.last_nm, self.last_sd_nm) = (mean, sd);

        let raw = (mean / sd).clamp(-BEYOND, BEYOND);
        if raw.is_nan() {
            // Sums beyond all numbers: nothing can be said of such a block.
            (self.last_nm, self.last_sd_nm, self.previous) = (0.0, self.sd_nm, None);
            return;
        }
        let previous = self.previous.replace(raw);
        let new = previous.map(|before| raw - self.correlation.clamp(0.0, MAX_CORRELATION) * before);
        let z = new.map_or(raw, |new| new / self.new_variance.sqrt());
        self.evidence = (self.evidence + test.evidence(z)).clamp(0.0, CEILING * test.threshold);
        if self.evidence >= test.threshold {
            self.alarm = true;
        } else if self.evidence <= if self.alarm { CLEAR * test.threshold } else { 0.0 } {
            self.calm();
        }
        if self.alarm {
            self.place = self.map.place(self.samples * allowed);
        }
        // Learning only from blocks that look quiet would take the noise for smaller and less correlated than it is;
        // what a mismatch adds before its alarm is clipped.
        if !self.alarm {
            self.learn(class, mean, test.memory);
            if let (Some(before), Some(new)) = (previous, new) {
                self.learn_succession(raw, before, new, test.memory);
            }
        }
    }

    /// Takes a quiet block into the noise estimate: within what the model file's noise allows.
    fn learn(&mut self, class: usize, mean: f64, memory: f64) {
        let noise = &mut self.noise[class];
        let limit = CLIP * noise.variance.sqrt();
        let clipped = mean.clamp(-limit, limit);
        noise.weight = (noise.weight + 1.0).min(memory);
        noise.variance += (clipped * clipped - noise.variance) / noise.weight;
        // Independent samples of the model file's noise give no less than this, the noise all in one no more.
        let least = self.sd_nm * self.sd_nm / self.samples.max(1.0);
        noise.variance = noise.variance.clamp(least, self.sd_nm * self.sd_nm);
    }

    /// Correlation of a block with the one before, and the variance of what is new in it. The latter is measured, not
    /// taken as 1 − r²: an r that is off then costs a little power, not false alarms.
    fn learn_succession(&mut self, raw: f64, before: f64, new: f64, memory: f64) {
        self.succession_weight = (self.succession_weight + 1.0).min(memory);
        let product = raw.clamp(-CLIP, CLIP) * before.clamp(-CLIP, CLIP);
        self.correlation += (product - self.correlation) / self.succession_weight;
        let square = (new * new).min(CLIP * CLIP * self.new_variance);
        self.new_variance += (square - self.new_variance) / self.succession_weight;
        self.new_variance = self.new_variance.clamp(1.0 - MAX_CORRELATION * MAX_CORRELATION, 1.0);
    }
}

/// Class of an acceleration [rad/s²].
fn class_of(acceleration: f64) -> usize {
    let octave = (acceleration / FIRST_CLASS).log2().ceil();
    // A number that is not finite belongs nowhere; the first class is the strictest.
    if octave.is_finite() { octave.clamp(0.0, (CLASSES - 1) as f64) as usize } else { 0 }
}
