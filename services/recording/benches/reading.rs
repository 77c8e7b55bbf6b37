//! Reading speed: CSV with 7 columns, and MCAP as our recorder writes it, in samples per second and as a ratio
//! to reading the same bytes without looking at them.
//!
//! Run it with `cargo bench -p lacuna-recording`.

#[path = "../tests/common/mod.rs"]
mod common;

use lacuna_interfaces::RobotFile;
use lacuna_recording::container::{Compression, WriterOptions};
use std::fmt::Write as _;
use std::hint::black_box;
use std::io::Read;
use std::path::Path;
use std::time::Instant;

const SAMPLES: usize = 400_000;

fn main() {
    let dir = tempfile::tempdir().expect("a temporary folder");
    let csv = dir.path().join("a.csv");
    let mut text = "t,q1,q2,q3,tau1,tau2,tau3\n".to_owned();
    for k in 0..SAMPLES {
        let t = k as f64 * 1e-3;
        let (a, b) = (t.sin(), t.cos());
        writeln!(text, "{t:.6},{a:.9},{b:.9},{:.9},{:.4},{:.4},{:.4}", a * b, a * 9.0, b * 9.0, a - b)
            .expect("room in memory");
    }
    std::fs::write(&csv, text).expect("room on the disk");
    let three =
        RobotFile::parse("kind = \"serial\"\nname = \"r\"\njoints = [\"a\", \"b\", \"c\"]\n[[dh]]\n[[dh]]\n[[dh]]\n")
            .expect("a valid robot file");
    compare("csv, 7 columns", &csv, &three);

    let samples = common::motion(SAMPLES);
    for compression in [Compression::None, Compression::Lz4, Compression::Zstd] {
        let mcap = dir.path().join("a.mcap");
        let options = WriterOptions { compression, overwrite: true, ..WriterOptions::default() };
        common::write_mcap(&mcap, &samples, &options);
        compare(&format!("mcap, {compression:?}"), &mcap, &common::robot());
    }
}

fn compare(what: &str, path: &Path, robot: &RobotFile) {
    let start = Instant::now();
    let mut file = std::fs::File::open(path).expect("the file");
    let (mut block, mut bytes) = (vec![0; 64 << 10], 0);
    loop {
        let n = file.read(&mut block).expect("a readable file");
        if n == 0 {
            break;
        }
        bytes += n;
        black_box(&block);
    }
    let bare = start.elapsed().as_secs_f64();
    let start = Instant::now();
    let mut reader = lacuna_recording::open(path, robot).expect("a good recording");
    let mut count = 0;
    while let Some(sample) = reader.next_sample().expect("good samples") {
        count += 1;
        black_box(sample);
    }
    let wall = start.elapsed().as_secs_f64();
    assert_eq!(count, SAMPLES);
    println!(
        "{what:<16} {:>6.2} M samples/s  {:>6.1} ns/sample  {:>6.0} MB/s  ({:.0} x the time of reading the bytes)",
        count as f64 / wall / 1e6,
        wall * 1e9 / count as f64,
        bytes as f64 / wall / 1e6,
        wall / bare
    );
}
