//! Whatever the bytes, readers answer with samples or with an error in words: no panic, no hang, no flood of
//! memory.

mod common;

use common::{COMPRESSIONS, csv, motion, robot, write_mcap};
use lacuna_recording::container::WriterOptions;
use lacuna_recording::messages::Messages;
use lacuna_recording::{inspect, open, read_all, recover};
use proptest::prelude::*;
use std::path::Path;

fn read(path: &Path, bytes: &[u8]) {
    std::fs::write(path, bytes).unwrap();
    match read_all(path, &robot()) {
        Ok(r) => assert!(!r.is_empty() && r.q_rad.iter().flatten().all(|v| v.is_finite())),
        Err(e) => assert!(!e.to_string().contains('\n'), "{e}"),
    }
}

/// A small valid file: MCAP in several small chunks, or CSV.
fn valid(kind: usize) -> (&'static str, Vec<u8>) {
    if kind == COMPRESSIONS.len() {
        return ("csv", csv(&motion(40)).into_bytes());
    }
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.mcap");
    let options = WriterOptions { compression: COMPRESSIONS[kind], chunk_bytes: 2000, ..WriterOptions::default() };
    write_mcap(&path, &motion(40), &options);
    ("mcap", std::fs::read(&path).unwrap())
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(256))]

    #[test]
    fn arbitrary_bytes(bytes in proptest::collection::vec(any::<u8>(), 0..2000), magic in any::<bool>()) {
        let dir = tempfile::tempdir().unwrap();
        read(&dir.path().join("a.csv"), &bytes);
        let head = if magic { mcap::MAGIC } else { &[] };
        read(&dir.path().join("a.mcap"), &[head, &bytes].concat());
    }

    #[test]
    fn arbitrary_text(text in "[-+0-9a-z.,;\\n\\r\" ]{0,400}") {
        let dir = tempfile::tempdir().unwrap();
        read(&dir.path().join("a.csv"), format!("t,q1,q2,tau1,tau2,x_ta,x_tb,x_enc,x_on\n{text}").as_bytes());
    }

    #[test]
    fn mutated_files(
        kind in 0..=COMPRESSIONS.len(),
        changes in proptest::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6),
        cut in any::<prop::sample::Index>(),
        cuts in any::<bool>(),
    ) {
        let (extension, mut bytes) = valid(kind);
        for (at, value) in changes {
            let at = at.index(bytes.len());
            bytes[at] = value;
        }
        if cuts {
            bytes.truncate(cut.index(bytes.len()));
        }
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join(format!("a.{extension}"));
        read(&path, &bytes);
        if extension == "mcap" {
            let _ = recover(&path, dir.path().join("b.mcap"), &WriterOptions::default());
        }
    }
}

#[test]
fn claims_of_size_are_not_believed() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.mcap");
    for opcode in 1..=20_u8 {
        for len in [1_u64 << 20, 1 << 40, u64::MAX - 8, u64::MAX] {
            let mut bytes = mcap::MAGIC.to_vec();
            bytes.push(opcode);
            bytes.extend(len.to_le_bytes());
            bytes.extend([7; 100]);
            std::fs::write(&path, &bytes).unwrap();
            assert!(open(&path, &robot()).and_then(|mut r| r.next_sample().map(|_| ())).is_err());
        }
    }
    // A chunk that claims to decompress to 2^60 bytes.
    let (_, mut bytes) = valid(2);
    let chunk = mcap_chunk(&bytes);
    bytes[chunk + 9 + 16..chunk + 9 + 24].copy_from_slice(&(1_u64 << 60).to_le_bytes());
    std::fs::write(&path, &bytes).unwrap();
    let e = open(&path, &robot()).unwrap_err().to_string();
    assert!(e.contains("claims"), "{e}");
}

/// Offset of the first chunk record.
fn mcap_chunk(bytes: &[u8]) -> usize {
    let mut at = mcap::MAGIC.len();
    while bytes[at] != mcap::records::op::CHUNK {
        at += 9 + u64::from_le_bytes(bytes[at + 1..at + 9].try_into().unwrap()) as usize;
    }
    at
}

#[test]
fn a_damaged_chunk_is_an_error_and_recovery_steps_over_it() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.mcap");
    let options = WriterOptions { chunk_bytes: 20_000, ..WriterOptions::default() };
    write_mcap(&path, &motion(1000), &options);
    let mut bytes = std::fs::read(&path).unwrap();
    let chunk = mcap_chunk(&bytes);
    bytes[chunk + 3000] ^= 0xff;
    std::fs::write(&path, &bytes).unwrap();
    let e = read_all(&path, &robot()).unwrap_err().to_string();
    assert!(e.contains(&format!("the chunk at byte {chunk} ")), "{e}");
    let to = dir.path().join("b.mcap");
    let recovered = recover(&path, &to, &WriterOptions::default()).unwrap();
    assert_eq!((recovered.was_cut, recovered.damages.len()), (false, 1));
    let left = read_all(&to, &robot()).unwrap();
    assert!(left.len() > 800 && left.len() < 1000, "{}", left.len());
    assert_eq!(left.t_s.last(), Some(&0.999));
}

/// Found by fuzzing: names from a hostile file broke the one line of an error.
#[test]
fn a_name_with_line_ends_is_quoted_on_one_line() {
    let dir = tempfile::tempdir().unwrap();
    let eni = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/drives.xml");
    let eni = std::fs::read_to_string(eni).unwrap().replace("<Name>Drive 1</Name>", "<Name>Dri\nve \u{9b}1</Name>");
    std::fs::write(dir.path().join("drives.xml"), eni).unwrap();
    let robot = "kind = \"serial\"\nname = \"pair\"\njoints = [\"a\", \"b\"]\n[[dh]]\n[[dh]]\n[drive]\ngear_ratio = [100, -50]\n\
        encoder_bits = [20, 19]\nrated_torque_nm = [200, 80]\n[ethercat]\neni = \"drives.xml\"\n[[ethercat.axis]]\n\
        slave = \"Drive 1\"\n[[ethercat.axis]]\nslave = \"Drive 2\"\n";
    std::fs::write(dir.path().join("robot.toml"), robot).unwrap();
    let line = lacuna_recording::load_robot(dir.path().join("robot.toml")).unwrap_err().to_string();
    assert!(line.contains("Dri\\nve \\u{9b}1") && !line.contains(char::is_control), "{line:?}");
}

fn record(opcode: u8, content: &[u8]) -> Vec<u8> {
    [&[opcode][..], &(content.len() as u64).to_le_bytes(), content].concat()
}

fn text(bytes: &[u8]) -> Vec<u8> {
    [&(bytes.len() as u32).to_le_bytes()[..], bytes].concat()
}

/// A chunk record, its content compressed with zstd.
fn chunk(content: &[u8]) -> Vec<u8> {
    let packed = zstd::bulk::compress(content, 1).unwrap();
    let sizes = [&[0; 16][..], &(content.len() as u64).to_le_bytes(), &[0; 4]].concat();
    let data = [(packed.len() as u64).to_le_bytes().to_vec(), packed].concat();
    record(mcap::records::op::CHUNK, &[sizes, text(b"zstd"), data].concat())
}

/// Declarations are kept while a file is read, and compressed they cost a hostile file nothing.
#[test]
fn a_flood_of_declarations_is_refused_and_repeated_ones_are_not() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.mcap");
    let flood = |ids: std::ops::Range<u16>| {
        let mut bytes = mcap::MAGIC.to_vec();
        bytes.extend(record(mcap::records::op::HEADER, &[text(b""), text(b"")].concat()));
        for id in ids {
            let schema =
                [&id.to_le_bytes()[..], &text(b"p/T"), &text(b"ros2msg"), &text(&vec![b' '; 16 << 20])].concat();
            bytes.extend(chunk(&record(mcap::records::op::SCHEMA, &schema)));
        }
        std::fs::write(&path, &bytes).unwrap();
        bytes.len()
    };
    assert!(flood(1..6) < 1 << 20, "16 MiB of blanks are small once compressed");
    let e = inspect(&path).unwrap_err().to_string();
    assert!(e.contains("64 MiB of schemas and channels") && e.contains("in the chunk at byte"), "{e}");
    assert!(Messages::open(&path).unwrap().next_message().is_err());
    // What a recorder says again in every chunk is one declaration.
    let mut bytes = std::fs::read(&path).unwrap();
    flood(1..2);
    let one = std::fs::read(&path).unwrap();
    bytes.truncate(one.len());
    let again = one[one.len() - chunk_len(&one)..].to_vec();
    (0..5).for_each(|_| bytes.extend(&again));
    std::fs::write(&path, &bytes).unwrap();
    assert!(inspect(&path).unwrap().was_cut);
}

/// Length of the last record of a file that consists of its header and one chunk.
fn chunk_len(bytes: &[u8]) -> usize {
    bytes.len() - mcap_chunk(bytes)
}

/// Chunks hold messages and what these need; a file hidden in one would be memory for nothing.
#[test]
fn an_attachment_within_a_chunk_is_none() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.mcap");
    let data = [&1_u64.to_le_bytes()[..], b"x"].concat();
    let attachment =
        record(mcap::records::op::ATTACHMENT, &[vec![0; 16], text(b"n"), text(b""), data, vec![0; 4]].concat());
    let header = record(mcap::records::op::HEADER, &[text(b""), text(b"")].concat());
    for (inside, found) in [(false, 1), (true, 0)] {
        let attachment = if inside { chunk(&attachment) } else { attachment.clone() };
        std::fs::write(&path, [mcap::MAGIC, &header, &attachment].concat()).unwrap();
        assert_eq!(inspect(&path).unwrap().attachments.len(), found);
    }
}

/// Behind bytes that are no record nobody knows where the next one begins: what follows must not be taken for records.
#[test]
fn recovery_ends_where_the_records_do() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.mcap");
    write_mcap(&path, &motion(1000), &WriterOptions { chunk_bytes: 20_000, ..WriterOptions::default() });
    let bytes = std::fs::read(&path).unwrap();
    let at = mcap_chunk(&bytes);
    // A hole of zeros, then bytes that would pass for a message of the first channel.
    let message = record(mcap::records::op::MESSAGE, &[&[1, 0][..], &[0; 20], b"not a message"].concat());
    let broken = [&bytes[..at], &[0; 8], &[9], &message].concat();
    std::fs::write(&path, broken).unwrap();
    let to = dir.path().join("b.mcap");
    let recovered = recover(&path, &to, &WriterOptions::default()).unwrap();
    assert_eq!((recovered.was_cut, recovered.damages.len()), (true, 1));
    assert_eq!(recovered.finished.messages.values().sum::<u64>(), 0);
}
