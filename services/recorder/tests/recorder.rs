//! What the recorder promises: counts, refusals, crash safety, no loss in silence.

mod common;

use common::{TOPICS, config, header, record, robot, run, stamp};
use lacuna_interfaces::{JointMeasured, PayloadEstimate, RepairKind, flag};
use lacuna_recorder::{Branch, Recorder, Run, Stream};
use lacuna_recording::{ReadOptions, open, open_with, read_all};
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Command, Stdio};

fn measured(seq: u64) -> JointMeasured {
    let mut h = header(seq);
    h.seq = seq;
    JointMeasured { header: h, ..JointMeasured::default() }
}

#[test]
fn our_own_reader_gives_back_what_was_recorded() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.mcap");
    let robot = robot();
    let mut recorder = Recorder::new(&config(&path, ""), &run(&robot, &Stream::ALL)).unwrap();
    for k in 0..5000 {
        record(&mut recorder, k).unwrap();
    }
    recorder.finish().unwrap();
    let r = read_all(&path, &robot).unwrap();
    assert_eq!((r.len(), r.repairs.len()), (5000, 0));
    assert_eq!(r.extra.keys().collect::<Vec<_>>(), ["temp1", "temp2", "temp3"]);
    for k in [0, 17, 4999] {
        for j in 0..3 {
            assert_eq!(r.q_rad[j][k], common::number(0, k as u64, j));
            assert_eq!(r.tau_nm[j][k], common::number(1, k as u64, j));
            assert_eq!(r.extra[&format!("temp{}", j + 1)][k], common::number(2, k as u64, j));
        }
    }
    // A topic without efforts is refused in words, not read as zeros.
    let options = ReadOptions { topic: Some("/smoothed".to_owned()), ..ReadOptions::default() };
    let e = open_with(&path, &robot, &options).unwrap_err().to_string();
    assert!(e.contains("found 0 effort values"), "{e}");
    let options = ReadOptions { topic: Some("/nowhere".to_owned()), ..ReadOptions::default() };
    let e = open_with(&path, &robot, &options).unwrap_err().to_string();
    assert!(e.contains("/nowhere") && e.contains("/measured"), "{e}");
}

#[test]
fn missing_and_repeated_sequence_numbers_are_counted() {
    let dir = tempfile::tempdir().unwrap();
    let robot = robot();
    let streams = [Stream::Measured];
    let mut recorder = Recorder::new(&config(&dir.path().join("a.mcap"), ""), &run(&robot, &streams)).unwrap();
    for seq in [3, 4, 5, 9, 9, 8, 10] {
        recorder.lane(0).unwrap().measured(&measured(seq)).unwrap();
    }
    let mut end = measured(11);
    end.header.flags = flag::END_OF_STREAM;
    recorder.lane(0).unwrap().measured(&end).unwrap();
    assert!(recorder.lane(0).unwrap().smoothed(&Default::default()).is_err(), "a stream that was not announced");
    let counts = recorder.finish().unwrap();
    assert_eq!(counts.samples["measured"], 7);
    assert_eq!(counts.missing["measured"], 2 + 3);
    assert_eq!(counts.repeated["measured"], 2);
    assert_eq!(counts.messages["/status"], 7, "the status comes with the last stream there is");
    assert!(!counts.lossless());
}

#[test]
fn an_existing_file_is_not_replaced_unless_asked() {
    let dir = tempfile::tempdir().unwrap();
    let robot = robot();
    for more in ["", "bag = true\n"] {
        let path = dir.path().join(format!("a{}", more.len()));
        let new = |more: &str| Recorder::new(&config(&path, more), &run(&robot, &Stream::ALL));
        new(more).unwrap().finish().unwrap();
        let e = new(more).unwrap_err().to_string();
        assert!(e.contains("existing") && e.contains("overwrite = true") && e.contains("a"), "{e}");
        new(&format!("{more}overwrite = true\n")).unwrap().finish().unwrap();
    }
}

#[test]
fn configurations_without_sense_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let robot = robot();
    for (more, expect) in [
        ("level = 99", "level: found 99; expected -7 to 22"),
        ("compression = \"lz4\"\nlevel = -1", "expected 0 to 16"),
        ("chunk_kib = 0", "chunk_kib"),
        ("flush_s = nan", "flush_s: found NaN"),
        ("flush_s = 0.0", "flush_s"),
        ("sync_s = inf", "sync_s"),
        ("queue_chunks = 0", "queue_chunks"),
    ] {
        let e = Recorder::new(&config(&dir.path().join("a"), more), &run(&robot, &Stream::ALL)).unwrap_err();
        assert!(e.to_string().contains(expect), "{e}");
    }
    assert!(!dir.path().join("a").exists());
    assert!(Recorder::new(&config(&dir.path().join("no/such/a"), ""), &run(&robot, &Stream::ALL)).is_err());
    assert!(toml::from_str::<lacuna_recorder::Config>("path = 'a'\ncolour = 1").is_err());
}

#[test]
fn a_full_disk_is_an_error_not_a_loss() {
    if !Path::new("/dev/full").exists() {
        eprintln!("SKIPPED: no /dev/full here");
        return;
    }
    let robot = robot();
    let result = Recorder::new(&config(Path::new("/dev/full"), "overwrite = true"), &run(&robot, &Stream::ALL));
    let e = result.map(|_| ()).unwrap_err().to_string();
    assert!(e.contains("/dev/full: cannot be written"), "{e}");
}

#[test]
fn two_recordings_of_the_same_input_are_the_same_bytes() {
    let dir = tempfile::tempdir().unwrap();
    let robot = robot();
    let write = |folder: &str| {
        std::fs::create_dir(dir.path().join(folder)).unwrap();
        let path = dir.path().join(folder).join("a.mcap");
        // Chunks are closed by size alone: the flush interval is longer than the test.
        let mut recorder = Recorder::new(&config(&path, "flush_s = 60.0"), &run(&robot, &Stream::ALL)).unwrap();
        for k in 0..3000 {
            record(&mut recorder, k).unwrap();
        }
        recorder.finish().unwrap();
        std::fs::read(path).unwrap()
    };
    assert!(write("x") == write("y"));
}

#[test]
fn a_live_recorder_never_waits_and_counts_what_it_drops() {
    // A FIFO that nobody reads: the writing thread blocks in its first write, as on a hanging disk.
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("fifo");
    if !Command::new("mkfifo").arg(&path).status().is_ok_and(|s| s.success()) {
        eprintln!("SKIPPED: no mkfifo here");
        return;
    }
    let robot = robot();
    let reader = std::thread::spawn({
        let path = path.clone();
        // Opens both of the writer's ends, then reads nothing until told.
        move || std::fs::File::open(path).unwrap()
    });
    let mut live = run(&robot, &Stream::ALL);
    live.live = true;
    let more = "overwrite = true\nsync_s = 0.0\nchunk_kib = 16\nqueue_chunks = 2\nflush_s = 60.0";
    let mut recorder = Recorder::new(&config(&path, more), &live).unwrap();
    let mut held = reader.join().unwrap();
    for k in 0..20_000 {
        record(&mut recorder, k).unwrap();
    }
    let dropped = recorder.counts().dropped;
    assert!(dropped > 100_000, "{dropped}");
    // The disk comes back: the thread goes on, and the recorder ends (a FIFO cannot be completed).
    let drain = std::thread::spawn(move || std::io::copy(&mut held, &mut std::io::sink()).unwrap());
    drop(recorder);
    assert!(drain.join().unwrap() > 16 << 10);
}

/// Not a test of its own: the process that [`a_killed_recorder_loses_at_most_the_flush_interval`] kills.
#[test]
fn crash_child() {
    let Some(path) = std::env::var_os("LACUNA_TEST_CRASH_FILE") else { return };
    let robot = robot();
    let mut recorder = Recorder::new(&config(Path::new(&path), ""), &run(&robot, &Stream::ALL)).unwrap();
    let start = std::time::Instant::now();
    for k in 0.. {
        // 4 kHz by the clock.
        let due = std::time::Duration::from_micros(250) * k as u32;
        if let Some(wait) = due.checked_sub(start.elapsed()) {
            std::thread::sleep(wait);
        }
        record(&mut recorder, k).unwrap();
        if k % 200 == 0 {
            println!("recorded {k}");
        }
    }
}

#[test]
fn a_killed_recorder_loses_at_most_the_flush_interval() {
    let dir = tempfile::tempdir().unwrap();
    for seconds in [0.9, 2.1] {
        let path = dir.path().join(format!("{seconds}.mcap"));
        let mut child = Command::new(std::env::current_exe().unwrap())
            .args(["crash_child", "--exact", "--nocapture"])
            .env("LACUNA_TEST_CRASH_FILE", &path)
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut last = 0;
        for line in BufReader::new(child.stdout.take().unwrap()).lines() {
            if let Some(k) = line.unwrap().strip_prefix("recorded ") {
                last = k.parse::<u64>().unwrap();
            }
            if last as f64 >= seconds * 4000.0 {
                child.kill().unwrap();
                break;
            }
        }
        child.wait().unwrap();
        let mut reader = open(&path, &robot()).unwrap();
        let mut count = 0;
        while let Some(sample) = reader.next_sample().unwrap() {
            assert_eq!(sample.measured.header.stamp_ns, stamp(count));
            count += 1;
        }
        // Half a second of 4 kHz, and as much again as the machine may lag while writing.
        assert!(count + 2000 + 1000 > last, "{count} of {last}");
        let cut = reader.repairs();
        assert_eq!(cut.iter().map(|r| r.kind).collect::<Vec<_>>(), [RepairKind::TruncatedTail]);
        let to = dir.path().join(format!("{seconds}-recovered.mcap"));
        let recovered = lacuna_recording::recover(&path, &to, &Default::default()).unwrap();
        assert!(recovered.was_cut);
        assert_eq!(read_all(&to, &robot()).unwrap().len() as u64, count);
        assert_eq!(recovered.finished.messages.len(), TOPICS.len());
    }
}

#[test]
fn branches_stand_below_their_namespace_and_are_counted_apart() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.mcap");
    let robot = robot();
    let branches = ["before", "after"]
        .map(|space| Branch { namespace: space.to_owned(), streams: vec![Stream::Friction, Stream::Payload] });
    let streams = [Stream::Measured];
    let run = Run { branches: &branches, ..run(&robot, &streams) };
    let mut recorder = Recorder::new(&config(&path, ""), &run).unwrap();
    let sample = |k: u64, nm: f64| PayloadEstimate { header: header(k), residual_nm: [nm; 8], ..Default::default() };
    for k in 0..100 {
        recorder.lane(0).unwrap().measured(&measured(k + 1)).unwrap();
        recorder.lane(1).unwrap().payload(&sample(k, 2.0)).unwrap();
        if k != 7 {
            recorder.lane(2).unwrap().payload(&sample(k, 1.0)).unwrap();
        }
    }
    assert!(recorder.lane(1).unwrap().measured(&measured(1)).is_err(), "not announced in this namespace");
    assert!(recorder.lane(3).is_err());
    let counts = recorder.finish().unwrap();
    assert_eq!((counts.samples["before/payload"], counts.samples["after/payload"]), (100, 99));
    assert_eq!(counts.missing.iter().collect::<Vec<_>>(), [(&"after/payload".to_owned(), &1)]);
    assert_eq!((counts.messages["/status"], counts.messages["/after/status"]), (100, 99));
    // The mcap crate, which shares no code with ours: every residual under its own topic.
    let bytes = std::fs::read(&path).unwrap();
    let mut found = std::collections::BTreeMap::<String, u64>::new();
    for message in mcap::MessageStream::new(&bytes).unwrap().map(Result::unwrap) {
        *found.entry(message.channel.topic.clone()).or_default() += 1;
        if let Some(expected) = match message.channel.topic.as_str() {
            "/before/residual" => Some(2.0),
            "/after/residual" => Some(1.0),
            _ => None,
        } {
            let last: [u8; 8] = message.data[message.data.len() - 8..].try_into().unwrap();
            assert_eq!(f64::from_le_bytes(last), expected);
        }
    }
    assert_eq!((found["/before/residual"], found["/after/residual"]), (100, 99));
    // What is read back as a recording is the robot's, not a branch's.
    assert_eq!(read_all(&path, &robot).unwrap().len(), 100);
}
