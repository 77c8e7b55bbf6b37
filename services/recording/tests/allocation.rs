//! Reading allocates nothing per sample.

mod common;

use allocation_counter::measure;
use common::{motion, robot, write, write_mcap};
use lacuna_recording::container::WriterOptions;
use lacuna_recording::{Reader, open};
use std::path::Path;

fn read(reader: &mut Reader, count: usize) {
    for _ in 0..count {
        assert!(reader.next_sample().unwrap().is_some());
    }
}

/// Allocations over 20 000 samples, after 5000 for warming up.
fn allocations(path: &Path) -> u64 {
    let mut reader = open(path, &robot()).unwrap();
    read(&mut reader, 5000);
    measure(|| read(&mut reader, 20_000)).count_total
}

#[test]
fn the_counter_counts() {
    assert_eq!(measure(|| drop(std::hint::black_box(vec![1.0_f64; 3]))).count_total, 1);
}

#[test]
fn reading_allocates_nothing_per_sample() {
    let dir = tempfile::tempdir().unwrap();
    let samples = motion(25_000);
    let csv = dir.path().join("a.csv");
    write("csv", &csv, &samples);
    assert_eq!(allocations(&csv), 0);
    let mcap = dir.path().join("a.mcap");
    write_mcap(&mcap, &samples, &WriterOptions::default());
    // Not per sample but per chunk: the compression's name in each chunk header.
    let chunks = std::fs::metadata(&mcap).unwrap().len() / 1000;
    let counted = allocations(&mcap);
    assert!(counted < 200 && counted < chunks, "{counted}");
}
