//! What the recorder promises: counts, refusals, crash safety, no loss in silence.

mod common;

use common::{TOPICS, config, header, record, robot, run, stamp};
use lacuna_interfaces::{JointMeasured, PayloadEstimate, RepairKind, flag};
use lacuna_recorder::{Before, Branch, Recorder, Run, Stream, before};
use lacuna_recording::container::WriterOptions;
use lacuna_recording::{ReadOptions, open, open_with, read_all, recover};
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
    assert_eq!(gaps(&dir.path().join("a.mcap")), [(3, "measured".to_owned(), 1, 2), (9, "measured".to_owned(), 6, 3)]);
}

/// What the file says is missing: stamp of the sample after it [ms], stream, first number, count; read with the `mcap`
/// crate, by the message's definition.
fn gaps(path: &Path) -> Vec<(u64, String, u64, u64)> {
    let bytes = std::fs::read(path).unwrap();
    let mut found = Vec::new();
    for message in mcap::MessageStream::new(&bytes).unwrap().map(Result::unwrap) {
        if message.channel.topic != "/gaps" {
            continue;
        }
        assert_eq!(message.channel.schema.as_ref().unwrap().name, "lacuna_msgs/msg/Gap");
        // Encapsulation, stamp, empty frame (length 1, NUL, aligned), then the stream's name and two numbers.
        let body = &message.data[4..];
        let word = |at: usize| u32::from_le_bytes(body[at..at + 4].try_into().unwrap()) as usize;
        let long = |at: usize| u64::from_le_bytes(body[at..at + 8].try_into().unwrap());
        let (at, len) = (20, word(16));
        let stream = std::str::from_utf8(&body[at..at + len - 1]).unwrap().to_owned();
        let numbers = (at + len).next_multiple_of(8);
        found.push((message.log_time / 1_000_000, stream, long(numbers), long(numbers + 8)));
    }
    found
}

#[test]
fn a_recording_that_goes_on_says_what_is_missing_between_the_files() {
    let dir = tempfile::tempdir().unwrap();
    let robot = robot();
    let path = |n: u32| dir.path().join(format!("{n}.mcap"));
    let streams = [Stream::Measured, Stream::Payload];
    let write = |n: u32, run_name: &str, seqs: std::ops::Range<u64>, cut: bool| {
        let mut facts = run(&robot, &streams);
        facts.resumed = n > 0;
        facts.facts.insert("run".to_owned(), run_name.to_owned());
        let more = "compression = \"none\"\nchunk_kib = 4";
        let mut recorder = Recorder::new(&config(&path(n), more), &facts).unwrap();
        for seq in seqs {
            recorder.lane(0).unwrap().measured(&measured(seq)).unwrap();
            // The stream behind it is ten samples late.
            if seq > 10 {
                let header = measured(seq - 10).header;
                recorder.lane(0).unwrap().payload(&PayloadEstimate { header, ..PayloadEstimate::default() }).unwrap();
            }
        }
        if cut {
            drop(recorder);
            let whole = std::fs::read(path(n)).unwrap();
            std::fs::write(path(n), &whole[..whole.len() - 100]).unwrap();
            return None;
        }
        Some(recorder)
    };
    assert!(write(0, "a", 1..501, true).is_none());
    assert!(write(1, "another", 1..2000, true).is_none());
    assert!(write(2, "a", 600..1001, true).is_none());
    // Where the files end depends on what the cut took; an independent reader says it.
    let last = |n: u32, topic: &str| {
        let recovered = dir.path().join("whole.mcap");
        let options = WriterOptions { overwrite: true, ..WriterOptions::default() };
        recover(path(n), &recovered, &options).unwrap();
        let bytes = std::fs::read(recovered).unwrap();
        let messages = mcap::MessageStream::new(&bytes).unwrap().map(Result::unwrap);
        u64::from(messages.filter(|m| m.channel.topic == topic).last().unwrap().sequence)
    };
    let ends = [(0, "/measured"), (2, "/measured"), (0, "/payload"), (2, "/payload")].map(|(n, topic)| last(n, topic));
    let found = before((0..5).map(path), "a");
    let mut recorder = write(3, "a", 1100..1201, false).unwrap();
    assert!(recorder.has_begun());
    let lost = recorder.continues(&found).unwrap();
    let between =
        |first_end: u64, begin: u64, second_end: u64, again: u64| (begin - first_end - 1) + (again - second_end - 1);
    assert_eq!(lost, between(ends[0], 600, ends[1], 1100).max(between(ends[2], 590, ends[3], 1090)));
    assert_eq!(recorder.last_seq(), 1200);
    let counts = recorder.finish().unwrap();
    let (measured, payload) = (1100 - ends[1] - 1, 1090 - ends[3] - 1);
    assert_eq!((counts.missing["measured"], counts.missing["payload"]), (measured, payload));
    let said = gaps(&path(3));
    assert_eq!(said[0], (1100, "measured".to_owned(), ends[1] + 1, measured));
    assert_eq!(said[1], (1090, "payload".to_owned(), ends[3] + 1, payload));
    // Nothing before it that is of this run: all is missing.
    assert_eq!(before((0..5).map(path), "b"), Before::default());
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
    // Every sample counts once, however many messages it is.
    assert!((15_000..20_000).contains(&recorder.unwritten()), "{}", recorder.unwritten());
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
