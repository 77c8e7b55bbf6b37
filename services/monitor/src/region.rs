//! Where a mismatch is: the mean residual over bins of velocity, position and load since its onset.

use lacuna_interfaces::region;

/// Bins of a variable, symmetric about 0.
const BINS: usize = 16;
/// Share of the mismatch that the region must hold.
const SHARE: f64 = 0.85;
/// Values beyond this have no place [any unit].
const LARGEST: f64 = 1e15;
/// A variable tells the place only if it explains so many times what a constant explains.
const BETTER_THAN_CONSTANT: f64 = 1.3;

/// Samples and their residual by the value of one variable.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Bins {
    /// The bins cover −`half` to `half`.
    half: f64,
    count: [f64; BINS],
    sum_nm: [f64; BINS],
}

impl Bins {
    fn new(half: f64) -> Self {
        Self { half, count: [0.0; BINS], sum_nm: [0.0; BINS] }
    }

    fn clear(&mut self) {
        (self.count, self.sum_nm) = ([0.0; BINS], [0.0; BINS]);
    }

    #[inline]
    fn add(&mut self, x: f64, residual_nm: f64) {
        if x.is_nan() || x.abs() > LARGEST {
            return;
        }
        while x.abs() >= self.half {
            self.widen();
        }
        let bin = ((x / self.half + 1.0) * (BINS / 2) as f64) as usize;
        if let (Some(n), Some(sum)) = (self.count.get_mut(bin), self.sum_nm.get_mut(bin)) {
            *n += 1.0;
            *sum += residual_nm;
        }
    }

    /// Twice the range: pairs of bins become the inner half.
    fn widen(&mut self) {
        let old = *self;
        *self = Self::new(2.0 * old.half);
        for (bin, (n, sum)) in old.count.iter().zip(old.sum_nm).enumerate() {
            let to = bin / 2 + BINS / 4;
            self.count[to] += n;
            self.sum_nm[to] += sum;
        }
    }

    /// Squared mean times count of every bin, less what noise alone gives it [Nm²].
    fn energy(&self, noise_nm2: f64) -> [f64; BINS] {
        let one = |n: f64, sum: f64| if n > 0.0 { (sum * sum / n - noise_nm2).max(0.0) } else { 0.0 };
        std::array::from_fn(|i| one(self.count[i], self.sum_nm[i]))
    }

    /// The shortest run of bins that holds `SHARE` of the energy.
    fn run(&self, energy: &[f64; BINS]) -> (f64, f64) {
        let enough = SHARE * energy.iter().sum::<f64>();
        let edge = |bin: usize| self.half * (bin as f64 / (BINS / 2) as f64 - 1.0);
        let mut best = (0, BINS);
        for from in 0..BINS {
            let mut held = 0.0;
            for to in from..BINS {
                held += energy[to];
                if held >= enough {
                    if to + 1 - from < best.1 - best.0 {
                        best = (from, to + 1);
                    }
                    break;
                }
            }
        }
        (edge(best.0), edge(best.1))
    }
}

/// A place: a code of [`region`] and the interval.
pub(crate) type Place = (u32, f64, f64);

/// The map of one joint.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Map {
    velocity: Bins,
    position: Bins,
    load: Bins,
    count: f64,
    sum_nm: f64,
}

impl Map {
    pub fn new() -> Self {
        Self { velocity: Bins::new(0.1), position: Bins::new(0.1), load: Bins::new(0.1), count: 0.0, sum_nm: 0.0 }
    }

    pub fn clear(&mut self) {
        [&mut self.velocity, &mut self.position, &mut self.load].into_iter().for_each(Bins::clear);
        (self.count, self.sum_nm) = (0.0, 0.0);
    }

    #[inline]
    pub fn add(&mut self, qd_rad_s: f64, q_rad: f64, load_nm: f64, residual_nm: f64) {
        self.velocity.add(qd_rad_s, residual_nm);
        self.position.add(q_rad, residual_nm);
        self.load.add(load_nm, residual_nm);
        self.count += 1.0;
        self.sum_nm += residual_nm;
    }

    /// The variable that explains most of the residual by its mean over bins, and where. `noise_nm2` is the energy
    /// that noise alone gives a bin.
    pub fn place(&self, noise_nm2: f64) -> Place {
        let constant = if self.count > 0.0 { self.sum_nm * self.sum_nm / self.count } else { 0.0 };
        let mut best = (region::TIME, 0.0, 0.0);
        let mut explained = BETTER_THAN_CONSTANT * (constant - noise_nm2).max(0.0);
        for (variable, bins) in
            [(region::VELOCITY, &self.velocity), (region::POSITION, &self.position), (region::LOAD, &self.load)]
        {
            let energy = bins.energy(noise_nm2);
            let total: f64 = energy.iter().sum();
            if total > explained {
                explained = total;
                let (low, high) = bins.run(&energy);
                best = (variable, low, high);
            }
        }
        best
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_residual_in_a_range_of_positions_is_found_there() {
        let mut map = Map::new();
        for k in 0..4000 {
            let t = f64::from(k) * 1e-3;
            let (q, qd) = ((3.0 * t).sin(), 3.0 * (3.0 * t).cos());
            map.add(qd, q, 5.0 * (7.0 * t).sin(), if q > 0.5 { 1.0 } else { 0.0 });
        }
        let (variable, low, high) = map.place(0.01);
        assert_eq!(variable, region::POSITION);
        // To a bin: they are 0.2 wide here.
        assert!((low - 0.5).abs() < 0.2 && high >= 1.0, "{low} to {high}");
        map.clear();
        assert_eq!(map.place(0.01).0, region::TIME);
    }

    #[test]
    fn friction_is_told_by_velocity_and_an_offset_by_time_alone() {
        let (mut friction, mut offset) = (Map::new(), Map::new());
        for k in 0..4000 {
            let t = f64::from(k) * 1e-3;
            let (q, qd) = ((3.0 * t).sin(), 3.0 * (3.0 * t).cos());
            friction.add(qd, q, 5.0 * (7.0 * t).sin(), qd.signum());
            offset.add(qd, q, 5.0 * (7.0 * t).sin(), 1.0);
        }
        assert_eq!(friction.place(0.01).0, region::VELOCITY);
        assert_eq!(offset.place(0.01).0, region::TIME);
    }

    #[test]
    fn no_number_breaks_it() {
        let mut map = Map::new();
        for x in [0.0, 1e300, -1e300, f64::INFINITY, f64::NAN, f64::MAX, f64::MIN_POSITIVE] {
            map.add(x, x, x, 1.0);
        }
        let (_, low, high) = map.place(0.0);
        assert!(low <= high);
    }
}
