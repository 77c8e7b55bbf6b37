//! Which seeds belong to whom.
//!
//! | seeds | use |
//! |---|---|
//! | below [`PROOF_FIRST`] | development, tests, calibration, users |
//! | [`PROOF_FIRST`] and above | the proof alone: never for development, never for calibration |
//!
//! A calibration refuses the proof's seeds. A proof with `--seed S` draws from a block of its own, so that a fresh, never seen proof is one option away.

pub use lacuna_simulate::case::PROOF_SEEDS_FROM as PROOF_FIRST;

/// Seeds of one proof; `--seed` chooses the block.
const BLOCK: u64 = 1 << 20;

/// Draws of one case that may fail (a robot that cannot follow its motion) before the proof gives up.
pub const ATTEMPTS: u64 = 32;

/// Largest block number.
pub const MOST: u64 = (1 << 23) - 1;

/// Seed of attempt `attempt` at case `case` of block `block`.
pub fn seed(block: u64, case: u64, attempt: u64) -> u64 {
    PROOF_FIRST + (block.min(MOST) * BLOCK) + (case * ATTEMPTS + attempt) % BLOCK
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blocks_cases_and_attempts_never_share_a_seed_and_none_is_anyone_elses() {
        let mut seen = std::collections::BTreeSet::new();
        for block in [0, 1, 2, MOST] {
            for case in 0..400 {
                for attempt in 0..ATTEMPTS {
                    let s = seed(block, case, attempt);
                    assert!(s >= PROOF_FIRST);
                    assert!(seen.insert(s), "{block} {case} {attempt}");
                }
            }
        }
    }
}
