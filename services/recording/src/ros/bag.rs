//! The quality-of-service description that ROS 2 bag tools want, and the `metadata.yaml` of a bag folder.

use std::fmt::Write as _;

/// What the topics of a recording offer: keep the last ten, reliable, volatile. The same text stands in the channels'
/// metadata and in `metadata.yaml`.
pub const OFFERED_QOS: &str = "\
- history: 1
  depth: 10
  reliability: 1
  durability: 2
  deadline:
    sec: 9223372036
    nsec: 854775807
  lifespan:
    sec: 9223372036
    nsec: 854775807
  liveliness: 1
  liveliness_lease_duration:
    sec: 9223372036
    nsec: 854775807
  avoid_ros_namespace_conventions: false
";

/// A topic of the bag.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Topic {
    /// Name.
    pub name: String,
    /// Type, `package/msg/Type`.
    pub kind: String,
    /// Messages written.
    pub count: u64,
}

/// `metadata.yaml` (version 5, which every ROS 2 release since Humble reads) of a bag of one MCAP file.
/// `start_ns` and `end_ns` are the first and last log time.
pub fn metadata_yaml(file: &str, start_ns: u64, end_ns: u64, topics: &[Topic]) -> String {
    let duration = end_ns.saturating_sub(start_ns);
    let total: u64 = topics.iter().map(|t| t.count).sum();
    let mut y = String::new();
    // Writing to a String cannot fail.
    let _ = write!(
        y,
        "rosbag2_bagfile_information:\n  version: 5\n  storage_identifier: mcap\n  duration:\n    nanoseconds: \
         {duration}\n  starting_time:\n    nanoseconds_since_epoch: {start_ns}\n  message_count: {total}\n  \
         topics_with_message_count:\n"
    );
    for t in topics {
        let _ = write!(
            y,
            "    - topic_metadata:\n        name: {}\n        type: {}\n        serialization_format: cdr\n        \
             offered_qos_profiles: {}\n      message_count: {}\n",
            quoted(&t.name),
            quoted(&t.kind),
            quoted(OFFERED_QOS),
            t.count
        );
    }
    let file = quoted(file);
    let _ = write!(
        y,
        "  compression_format: \"\"\n  compression_mode: \"\"\n  relative_file_paths:\n    - {file}\n  files:\n    - \
         path: {file}\n      starting_time:\n        nanoseconds_since_epoch: {start_ns}\n      duration:\n        \
         nanoseconds: {duration}\n      message_count: {total}\n"
    );
    y
}

/// A YAML double-quoted scalar.
fn quoted(s: &str) -> String {
    let mut out = String::from("\"");
    for c in s.chars() {
        match c {
            '"' => out.push_str("\\\""),
            '\\' => out.push_str("\\\\"),
            '\n' => out.push_str("\\n"),
            c if c.is_control() => {
                let _ = write!(out, "\\u{:04x}", c as u32);
            }
            c => out.push(c),
        }
    }
    out.push('"');
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quoting_survives_hostile_names() {
        assert_eq!(quoted("a\"b\\c\nd\u{1}"), "\"a\\\"b\\\\c\\nd\\u0001\"");
    }
}
