//! `lacuna hz`: how often samples come, topic by topic, in a recording or in a live graph that is running.

use crate::echo::{WhatArgs, observe};
use crate::{CommandResult, words};
use clap::Args;
use lacuna_interfaces::wire::MAX_HOPS;
use lacuna_recording::ReadOptions;
use lacuna_recording::messages::Messages;
use lacuna_stage::Failure;
use serde::Serialize;
use std::fmt::Write as _;
use std::path::Path;
use std::process::ExitCode;
use std::time::Duration;

#[derive(Args)]
pub struct HzArgs {
    #[command(flatten)]
    what: WhatArgs,
    /// How long a running graph is looked at [s].
    #[arg(long, value_name = "SECONDS", default_value_t = 5.0, allow_negative_numbers = true)]
    seconds: f64,
    /// Machine-readable output.
    #[arg(long)]
    json: bool,
}

/// What `--json` prints.
#[derive(Debug, Serialize)]
struct Report {
    schema: &'static str,
    /// `recording`: between the times of measurement; `live`: between the publications.
    between: &'static str,
    topics: Vec<Row>,
}

#[derive(Debug, Serialize)]
struct Row {
    topic: String,
    messages: u64,
    /// From the first to the last [s].
    duration_s: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    rate_hz: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    period: Option<Period>,
    /// Steps back in time, or none at all.
    not_increasing: u64,
    /// Samples missing in the sequence (live).
    missing: u64,
}

#[derive(Debug, Serialize)]
struct Period {
    min_s: f64,
    max_s: f64,
    mean_s: f64,
    sd_s: f64,
    /// Time after the first message at which the longest step begins [s].
    longest_at_s: f64,
}

/// Steps in time of one topic, in constant memory.
#[derive(Debug, Clone, Default)]
struct Steps {
    messages: u64,
    first_ns: i64,
    last_ns: i64,
    newest_ns: i64,
    steps: u64,
    min_ns: i64,
    max_ns: i64,
    longest_at_ns: i64,
    /// Welford's mean and sum of squares [ns].
    mean: f64,
    squares: f64,
    not_increasing: u64,
    missing: u64,
}

impl Steps {
    fn saw(&mut self, at_ns: i64) {
        self.messages += 1;
        if self.messages == 1 {
            (self.first_ns, self.last_ns, self.newest_ns, self.min_ns) = (at_ns, at_ns, at_ns, i64::MAX);
            return;
        }
        let step = at_ns.saturating_sub(self.last_ns);
        if step <= 0 {
            self.not_increasing += 1;
        }
        self.steps += 1;
        self.min_ns = self.min_ns.min(step);
        if step > self.max_ns {
            (self.max_ns, self.longest_at_ns) = (step, self.last_ns);
        }
        let off = step as f64 - self.mean;
        self.mean += off / self.steps as f64;
        self.squares += off * (step as f64 - self.mean);
        self.last_ns = at_ns;
        self.newest_ns = self.newest_ns.max(at_ns);
    }

    fn row(&self, topic: &str) -> Row {
        let seconds = |ns: i64| ns as f64 / 1e9;
        let duration_s = seconds(self.newest_ns.saturating_sub(self.first_ns));
        let period = (self.steps > 0).then(|| Period {
            min_s: seconds(self.min_ns),
            max_s: seconds(self.max_ns),
            mean_s: self.mean / 1e9,
            sd_s: (self.squares / self.steps as f64).sqrt() / 1e9,
            longest_at_s: seconds(self.longest_at_ns.saturating_sub(self.first_ns)),
        });
        Row {
            topic: topic.to_owned(),
            messages: self.messages,
            duration_s,
            rate_hz: (duration_s > 0.0).then(|| self.steps as f64 / duration_s),
            period,
            not_increasing: self.not_increasing,
            missing: self.missing,
        }
    }
}

/// `lacuna hz`.
pub fn hz(args: &HzArgs) -> CommandResult {
    let seconds = words::positive("--seconds", args.seconds)?;
    let (between, topics) = match &args.what.recording {
        Some(recording) => ("recording", recorded(recording, args)?),
        None => ("live", live(args, Duration::try_from_secs_f64(seconds).unwrap_or(Duration::MAX))?),
    };
    let topics = topics.iter().map(|(topic, steps)| steps.row(topic)).collect();
    let report = Report { schema: "lacuna.hz/1", between, topics };
    if args.json {
        words::print_json(&report)?;
    } else {
        words::say(&table(&report))?;
    }
    Ok(ExitCode::SUCCESS)
}

fn recorded(recording: &Path, args: &HzArgs) -> Result<Vec<(String, Steps)>, Failure> {
    let wanted = &args.what.topics;
    if let Some(robot) = &args.what.robot {
        let robot = lacuna_recording::load_robot(robot)?.file;
        let options = ReadOptions { topic: wanted.first().cloned(), ..ReadOptions::default() };
        let mut reader = lacuna_recording::open_with(recording, &robot, &options)?;
        let mut steps = Steps::default();
        while let Some(sample) = reader.next_sample()? {
            steps.saw(sample.measured.header.stamp_ns);
        }
        return Ok(vec![("measured".to_owned(), steps)]);
    }
    // Refuses what is no MCAP, and topics that are not there.
    crate::lines::Lines::open(recording, None, wanted)?;
    let mut messages = Messages::open(recording)?;
    let mut found: Vec<Steps> = Vec::new();
    while let Some(message) = messages.next_message()? {
        if found.len() <= message.topic {
            found.resize(messages.topics().len(), Steps::default());
        }
        if let Some(steps) = found.get_mut(message.topic) {
            steps.saw(message.stamp_ns);
        }
    }
    let named = messages.topics().iter().map(|t| t.name.clone()).zip(found);
    Ok(named.filter(|(name, _)| wanted.is_empty() || wanted.contains(name)).collect())
}

fn live(args: &HzArgs, limit: Duration) -> Result<Vec<(String, Steps)>, Failure> {
    let mut found: Vec<(String, Steps)> = Vec::new();
    let run = args.what.run.as_deref().unwrap_or("");
    observe(run, &args.what.topics, Some(limit), &mut |topic, message, missing| {
        let header = message.header();
        // When it was published, as its writer noted: not when it was looked at here.
        let hop = (header.hops as usize).min(MAX_HOPS).saturating_sub(1);
        let at_ns = header.hop_ns.get(hop).copied().unwrap_or(0).min(i64::MAX as u64) as i64;
        let index = found.iter().position(|(name, _)| name == topic).unwrap_or_else(|| {
            found.push((topic.to_owned(), Steps::default()));
            found.len() - 1
        });
        if let Some((_, steps)) = found.get_mut(index) {
            steps.missing += missing;
            steps.saw(at_ns);
        }
        Ok(true)
    })?;
    Ok(found)
}

fn table(report: &Report) -> String {
    let width = report.topics.iter().map(|r| r.topic.chars().count()).max().unwrap_or(0).max(5);
    let mut text = String::new();
    // Writing to a String cannot fail.
    let _ = writeln!(
        text,
        "{:width$}  {:>9}  {:>10}  {:>10}  {:>10}  {:>10}  {:>10}",
        "Topic", "Messages", "Rate [Hz]", "min [ms]", "mean [ms]", "max [ms]", "sd [ms]"
    );
    let shown = |v: Option<f64>, digits: usize| v.map_or_else(|| "–".to_owned(), |v| format!("{v:.digits$}"));
    for r in &report.topics {
        let p = r.period.as_ref();
        let _ = writeln!(
            text,
            "{:width$}  {:>9}  {:>10}  {:>10}  {:>10}  {:>10}  {:>10}",
            r.topic,
            r.messages,
            shown(r.rate_hz, 2),
            shown(p.map(|p| 1e3 * p.min_s), 4),
            shown(p.map(|p| 1e3 * p.mean_s), 4),
            shown(p.map(|p| 1e3 * p.max_s), 4),
            shown(p.map(|p| 1e3 * p.sd_s), 4),
        );
    }
    for r in report.topics.iter().filter(|r| r.not_increasing > 0) {
        let _ =
            writeln!(text, "{}: {} without progress in time", r.topic, words::count(r.not_increasing as usize, "step"));
    }
    for r in report.topics.iter().filter(|r| r.missing > 0) {
        let _ = writeln!(text, "{}: {} missing in the sequence", r.topic, words::count(r.missing as usize, "sample"));
    }
    if report.topics.is_empty() {
        text.push_str("no message\n");
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_are_counted_as_by_hand() {
        let mut steps = Steps::default();
        // Steps of 1, 1, 4 and 0 ms.
        [10_000_000, 11_000_000, 12_000_000, 16_000_000, 16_000_000].into_iter().for_each(|at| steps.saw(at));
        let row = steps.row("t");
        assert_eq!((row.messages, row.not_increasing), (5, 1));
        assert!((row.duration_s - 0.006).abs() < 1e-15 && (row.rate_hz.unwrap() - 4.0 / 0.006).abs() < 1e-9);
        let p = row.period.unwrap();
        assert!((p.mean_s - 0.0015).abs() < 1e-15 && (p.max_s - 0.004).abs() < 1e-15 && p.min_s == 0.0);
        // Population: deviations −0.5, −0.5, 2.5, −1.5 ms.
        assert!((p.sd_s - (9.0_f64 / 4.0).sqrt() * 1e-3).abs() < 1e-12, "{}", p.sd_s);
        assert!((p.longest_at_s - 0.002).abs() < 1e-15);
        let single = {
            let mut s = Steps::default();
            s.saw(5);
            s.row("t")
        };
        assert!(single.rate_hz.is_none() && single.period.is_none());
    }
}
