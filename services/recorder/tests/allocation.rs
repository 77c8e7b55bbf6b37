//! Recording allocates nothing per sample in the caller's thread.

mod common;

use allocation_counter::measure;
use common::{config, record, robot, run};
use lacuna_recorder::{Recorder, Stream};

#[test]
fn recording_allocates_nothing_per_sample() {
    let dir = tempfile::tempdir().unwrap();
    let robot = robot();
    let config = config(&dir.path().join("a.mcap"), "chunk_kib = 16\nqueue_chunks = 2\n");
    let mut recorder = Recorder::new(&config, &run(&robot, &Stream::ALL)).unwrap();
    let mut k = 0;
    let mut some = |count| {
        for _ in 0..count {
            record(&mut recorder, k).unwrap();
            k += 1;
        }
    };
    // Every chunk of the pool has been through once.
    some(500);
    // 5000 samples are 55 000 messages. The queue allocates once when it first has to wait, whenever that is.
    let counted = measure(|| some(5000)).count_total;
    assert!(counted < 10, "{counted}");
    let counts = recorder.finish().unwrap();
    assert_eq!(counts.messages["/measured"], 5500);
}
