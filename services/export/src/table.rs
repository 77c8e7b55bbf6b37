//! The table between the recording and the file formats.

use lacuna_recording::EPOCH_FROM_S;

/// Rows that are handed over at once; a Parquet row group.
pub const BLOCK_ROWS: usize = 1 << 16;

/// What a column holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// A measured or computed number.
    Float,
    /// A count or a set of flags: a whole number below 2^53.
    Integer,
    /// Yes or no.
    Flag,
}

/// A column, time aside.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Column {
    /// Name, distinct in the table: topic, quantity with its unit, joint (`measured_q_rad_elbow`).
    pub name: String,
    /// Topic and quantity (`measured_q_rad`): the columns of one group differ by joint alone.
    pub group: String,
    /// Joint, or the number in a list without names.
    pub joint: Option<String>,
    /// Topic, as the recording names it; empty for a recording without topics.
    pub topic: String,
    /// Unit, empty for none.
    pub unit: String,
    /// What it holds.
    pub kind: Kind,
}

/// The columns and where they come from. Every row also has a stamp.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Table {
    /// Columns.
    pub columns: Vec<Column>,
    /// File name of the recording.
    pub recording: String,
    /// Name of the robot, where it is known.
    pub robot: Option<String>,
    /// Stamp at which `t_s` is 0 [ns]: the first one for a recording with times since 1970, else 0.
    pub origin_ns: i64,
}

/// Rows, column by column.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Block {
    /// Stamps [ns], increasing.
    pub stamps_ns: Vec<i64>,
    /// `values[column][row]`; NaN where there is none.
    pub values: Vec<Vec<f64>>,
}

impl Table {
    /// Where `t_s` is 0, for a recording whose first stamp this is.
    pub(crate) fn origin_of(first_ns: i64) -> i64 {
        if first_ns as f64 >= EPOCH_FROM_S * 1e9 { first_ns } else { 0 }
    }

    /// Time of a row [s].
    pub fn t_s(&self, stamp_ns: i64) -> f64 {
        // Dividing (not multiplying by 1e-9) gives back the decimal that the recording holds.
        stamp_ns.saturating_sub(self.origin_ns) as f64 / 1e9
    }

    /// The column that is called `name`.
    pub fn column(&self, name: &str) -> Option<usize> {
        self.columns.iter().position(|c| c.name == name)
    }

    /// Makes names distinct that are not (topics `/a/b` and `/a_b`): the later ones get a number.
    pub(crate) fn distinguish(&mut self) {
        let mut seen: Vec<String> = vec!["t_s".to_owned(), "stamp_ns".to_owned()];
        for column in &mut self.columns {
            let mut name = column.name.clone();
            let mut n = 1;
            while seen.contains(&name) {
                n += 1;
                name = format!("{}_{n}", column.name);
            }
            seen.push(name.clone());
            column.name = name;
        }
    }
}

impl Block {
    /// An empty block of so many columns.
    pub fn new(columns: usize) -> Self {
        Self { stamps_ns: Vec::new(), values: vec![Vec::new(); columns] }
    }

    /// Rows.
    pub fn len(&self) -> usize {
        self.stamps_ns.len()
    }

    /// True without a row.
    pub fn is_empty(&self) -> bool {
        self.stamps_ns.is_empty()
    }

    pub(crate) fn clear(&mut self) {
        self.stamps_ns.clear();
        self.values.iter_mut().for_each(Vec::clear);
    }

    pub(crate) fn push(&mut self, stamp_ns: i64, row: &[f64]) {
        self.stamps_ns.push(stamp_ns);
        for (column, value) in self.values.iter_mut().zip(row) {
            column.push(*value);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_become_distinct() {
        let column = |name: &str| Column {
            name: name.to_owned(),
            group: String::new(),
            joint: None,
            topic: String::new(),
            unit: String::new(),
            kind: Kind::Float,
        };
        let columns = ["a", "a", "t_s", "a_2", "b"].map(column).to_vec();
        let mut table = Table { columns, recording: String::new(), robot: None, origin_ns: 0 };
        table.distinguish();
        let names: Vec<&str> = table.columns.iter().map(|c| c.name.as_str()).collect();
        assert_eq!(names, ["a", "a_2", "t_s_2", "a_2_2", "b"]);
        assert_eq!(table.column("b"), Some(4));
    }

    #[test]
    fn times_since_1970_count_from_the_first_sample() {
        let origin = Table::origin_of(1_700_000_000_000_000_123);
        assert_eq!((origin, Table::origin_of(5_000_000_000)), (1_700_000_000_000_000_123, 0));
    }
}
