//! The topics of a recording, joined by stamp: one row per stamp.
//!
//! The messages of one sample lie apart in a recording, since each stage is behind the one before. A row leaves the
//! window once every topic has gone beyond its stamp, or when the window is full: memory does not grow with the
//! recording. What comes for a row that has left is counted and missing.

use crate::plan::{Plan, with_messages};
use crate::table::{BLOCK_ROWS, Block, Table};
use crate::{Exported, Request, RowSource};
use lacuna_interfaces::BadInput;
use lacuna_recording::messages::Messages;
use lacuna_recording::ros::definition::Decoded;
use std::collections::VecDeque;

/// Numbers that wait for other topics at most (128 MB).
const MAX_WAITING: usize = 16 << 20;
/// Rows that may wait in any case.
const MIN_ROWS: usize = 1024;
/// Rows that wait at most.
const MAX_ROWS: usize = 1 << 16;

/// Rows of joined messages.
pub(crate) struct Joined {
    plan: Plan,
    messages: Messages,
    decoded: Decoded,
    window: Window,
    /// Stamps from here on, and up to here, are exported [ns].
    from_ns: i64,
    to_ns: i64,
    ended: bool,
    late: u64,
    repeated: u64,
}

/// Rows that wait, by stamp.
#[derive(Debug)]
struct Window {
    rows: VecDeque<(i64, Vec<f64>)>,
    /// Rows to be used again.
    spare: Vec<Vec<f64>>,
    width: usize,
    most: usize,
    /// Newest stamp of every topic that has messages.
    newest: Vec<Option<i64>>,
    /// Stamp of the row that left last.
    left: Option<i64>,
}

impl Window {
    /// The row of `stamp`; `None` if it has left.
    fn row(&mut self, stamp: i64) -> Option<&mut Vec<f64>> {
        if self.left.is_some_and(|left| stamp <= left) {
            return None;
        }
        // Almost always at the end or near it.
        let at = self.rows.partition_point(|(s, _)| *s < stamp);
        if self.rows.get(at).is_none_or(|(s, _)| *s != stamp) {
            let mut row = self.spare.pop().unwrap_or_default();
            row.clear();
            row.resize(self.width, f64::NAN);
            self.rows.insert(at, (stamp, row));
        }
        self.rows.get_mut(at).map(|(_, row)| row)
    }

    fn saw(&mut self, topic: usize, stamp: i64) {
        if let Some(Some(newest)) = self.newest.get_mut(topic) {
            *newest = stamp.max(*newest);
        }
    }

    /// Moves rows that no topic will add to into `block`, until it is full.
    fn leave(&mut self, block: &mut Block, all: bool) {
        // Every topic has passed what is older than this.
        let passed = self.newest.iter().flatten().min().copied().unwrap_or(i64::MIN);
        while block.len() < BLOCK_ROWS {
            let due = self.rows.front().is_some_and(|(s, _)| all || *s < passed || self.rows.len() > self.most);
            let Some((stamp, row)) = (if due { self.rows.pop_front() } else { None }) else { return };
            block.push(stamp, &row);
            self.left = Some(stamp);
            self.spare.push(row);
        }
    }
}

impl Joined {
    /// Reads the recording through for its columns, and opens it for its rows.
    pub(crate) fn open(request: &Request<'_>, progress: &mut dyn FnMut(f64)) -> Result<Self, BadInput> {
        if !lacuna_recording::is_mcap(request.recording)? {
            let what = "found a recording without topics; expected --robot FILE, which says what its columns are";
            return Err(BadInput::new(what).in_file(request.recording));
        }
        let plan = Plan::of(request, progress)?;
        let width = plan.table.columns.len();
        let with = with_messages(&plan.topics);
        let newest = (0..plan.topics.len()).map(|i| with.contains(&i).then_some(i64::MIN)).collect();
        let most = (MAX_WAITING / width.max(1)).clamp(MIN_ROWS, MAX_ROWS);
        let offset = |s: f64| plan.first_ns.saturating_add((s * 1e9) as i64);
        Ok(Self {
            from_ns: offset(request.from_s),
            // A cast from f64 saturates: to the end of time.
            to_ns: offset(request.to_s),
            messages: Messages::open(request.recording)?,
            decoded: Decoded::default(),
            window: Window { rows: VecDeque::new(), spare: Vec::new(), width, most, newest, left: None },
            plan,
            ended: false,
            late: 0,
            repeated: 0,
        })
    }

    /// Takes the next message into the window; `false` at the end.
    fn take(&mut self) -> Result<bool, BadInput> {
        let Some(message) = self.messages.next_message()? else { return Ok(false) };
        let Some(Some(plan)) = self.plan.topics.get_mut(message.topic) else { return Ok(true) };
        let Some(topic) = self.messages.topic(message.topic) else { return Ok(true) };
        let stamp = message.stamp_ns;
        self.window.saw(message.topic, stamp);
        if stamp < self.from_ns || stamp >= self.to_ns {
            return Ok(true);
        }
        let data = self.messages.data();
        topic.decode(data, &mut self.decoded).map_err(|e| e.in_file(self.messages.path()))?;
        let Some(row) = self.window.row(stamp) else {
            self.late += 1;
            return Ok(true);
        };
        let mut again = false;
        plan.values(data, &self.decoded, |column, value| {
            if let Some(slot) = row.get_mut(column) {
                again |= !slot.is_nan();
                *slot = value;
            }
        });
        self.repeated += u64::from(again);
        Ok(true)
    }
}

impl RowSource for Joined {
    fn table(&self) -> &Table {
        &self.plan.table
    }

    fn next_block(&mut self, block: &mut Block) -> Result<bool, BadInput> {
        /// Messages between two looks at the window.
        const BURST: usize = 256;
        block.clear();
        while block.len() < BLOCK_ROWS {
            if self.ended {
                self.window.leave(block, true);
                break;
            }
            for _ in 0..BURST {
                if !self.take()? {
                    self.ended = true;
                    break;
                }
            }
            self.window.leave(block, false);
        }
        Ok(!block.is_empty())
    }

    fn fraction(&self) -> f64 {
        self.messages.fraction()
    }

    fn account(&self, exported: &mut Exported) {
        exported.left_out.clone_from(&self.plan.left_out);
        exported.late = self.late;
        exported.repeated = self.repeated;
        exported.was_cut = self.messages.was_cut();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn window(most: usize, topics: usize) -> Window {
        let newest = vec![Some(i64::MIN); topics];
        Window { rows: VecDeque::new(), spare: Vec::new(), width: topics, most, newest, left: None }
    }

    fn put(window: &mut Window, topic: usize, stamp: i64) -> bool {
        window.saw(topic, stamp);
        window.row(stamp).map(|row| row[topic] = stamp as f64).is_some()
    }

    #[test]
    fn a_row_waits_for_the_slowest_topic() {
        let mut w = window(100, 2);
        let mut block = Block::new(2);
        (1..=5).for_each(|s| assert!(put(&mut w, 0, s)));
        w.leave(&mut block, false);
        assert!(block.is_empty());
        (1..=3).for_each(|s| assert!(put(&mut w, 1, s)));
        w.leave(&mut block, false);
        assert_eq!(block.stamps_ns, [1, 2]);
        w.leave(&mut block, true);
        assert_eq!(
            (block.stamps_ns.as_slice(), &block.values[0][..]),
            (&[1, 2, 3, 4, 5][..], &[1.0, 2.0, 3.0, 4.0, 5.0][..])
        );
        assert!(block.values[1][3].is_nan() && block.values[1][2] == 3.0);
    }

    #[test]
    fn a_full_window_lets_go_and_what_comes_later_is_told() {
        let mut w = window(3, 2);
        let mut block = Block::new(2);
        (1..=6).for_each(|s| assert!(put(&mut w, 0, s)));
        w.leave(&mut block, false);
        assert_eq!(block.stamps_ns, [1, 2, 3]);
        assert!(!put(&mut w, 1, 3), "its row has left");
        assert!(put(&mut w, 1, 4));
        // Out of order, but still in time.
        assert!(put(&mut w, 0, 9) && put(&mut w, 0, 8));
        w.leave(&mut block, true);
        assert_eq!(block.stamps_ns, [1, 2, 3, 4, 5, 6, 8, 9]);
    }
}
