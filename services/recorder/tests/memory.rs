//! Memory does not grow with the length of a recording, neither while writing nor while reading.

mod common;

use common::{config, record, robot, run};
use lacuna_recorder::{Recorder, Stream};

/// Resident memory of this process [kB].
fn resident_kb() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap();
    let line = status.lines().find(|l| l.starts_with("VmRSS:")).unwrap();
    line.split_whitespace().nth(1).unwrap().parse().unwrap()
}

#[test]
fn a_long_recording_takes_no_more_memory_than_a_short_one() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.mcap");
    let robot = robot();
    // Small chunks: many of them, and a small pool that is soon in use throughout.
    let config = config(&path, "chunk_kib = 16\nqueue_chunks = 4\n");
    let mut recorder = Recorder::new(&config, &run(&robot, &Stream::ALL)).unwrap();
    let mut k = 0;
    let mut some = |recorder: &mut Recorder, count| {
        for _ in 0..count {
            record(recorder, k).unwrap();
            k += 1;
        }
    };
    some(&mut recorder, 5_000);
    let short = resident_kb();
    some(&mut recorder, 150_000);
    let long = resident_kb();
    assert!(long < short + 1500, "writing: {short} kB, then {long} kB");
    recorder.finish().unwrap();
    let finished = resident_kb();
    assert!(finished < short + 1500, "finishing: {short} kB, then {finished} kB");

    let mut reader = lacuna_recording::open(&path, &robot).unwrap();
    let mut count = 0;
    let mut at_start = 0;
    while reader.next_sample().unwrap().is_some() {
        count += 1;
        if count == 5_000 {
            at_start = resident_kb();
        }
    }
    let at_end = resident_kb();
    assert_eq!(count, 155_000);
    assert!(at_end < at_start + 1500, "reading: {at_start} kB, then {at_end} kB");
}
