//! The baseline of all graph benchmarks: a chain of processes that only copy messages over iceoryx2, with
//! none of Lacuna's harness. `lacuna bench` starts one process per role.
//!
//! `lacuna-bare-chain DOMAIN.toml ROLE INDEX STAGES COUNT BUFFER PERIOD_NS` with ROLE source, relay or sink.
//! The sink prints one JSON line: samples, seconds between the first and the last, latency percentiles.
//! Everybody polls and yields, which is the quickest way on few cores.

use hdrhistogram::Histogram;
use iceoryx2::prelude::*;
use std::process::ExitCode;
use std::time::{Duration, Instant};

/// As large as the mean of the five messages of the graph: 552 B.
const WORDS: usize = 69;

#[repr(C)]
#[derive(Debug, Clone, Copy, ZeroCopySend)]
struct Message {
    seq: u64,
    sent_ns: u64,
    rest: [u64; WORDS - 2],
}

type AnyError = Box<dyn std::error::Error>;

fn monotonic_ns() -> u64 {
    let t = rustix::time::clock_gettime(rustix::time::ClockId::Monotonic);
    t.tv_sec as u64 * 1_000_000_000 + t.tv_nsec as u64
}

struct Chain {
    node: Node<ipc::Service>,
    buffer: usize,
}

impl Chain {
    fn service(
        &self,
        edge: usize,
    ) -> Result<iceoryx2::service::port_factory::publish_subscribe::PortFactory<ipc::Service, Message, ()>, AnyError>
    {
        let name: ServiceName = format!("edge{edge}").as_str().try_into()?;
        let started = Instant::now();
        loop {
            let result = self
                .node
                .service_builder(&name)
                .publish_subscribe::<Message>()
                .enable_safe_overflow(false)
                .history_size(0)
                .subscriber_max_buffer_size(self.buffer)
                .subscriber_max_borrowed_samples(2)
                .max_publishers(1)
                .max_subscribers(1)
                .open_or_create();
            match result {
                Ok(service) => return Ok(service),
                Err(e) if started.elapsed() > Duration::from_secs(10) => return Err(e.into()),
                Err(_) => std::thread::sleep(Duration::from_millis(5)),
            }
        }
    }
}

fn run() -> Result<(), AnyError> {
    let args: Vec<String> = std::env::args().collect();
    let [_, domain, role, index, stages, count, buffer, period] = args.as_slice() else {
        return Err("usage: lacuna-bare-chain DOMAIN.toml source|relay|sink INDEX STAGES COUNT BUFFER PERIOD_NS".into());
    };
    let (index, stages): (usize, usize) = (index.parse()?, stages.parse()?);
    let (count, period): (u64, u64) = (count.parse()?, period.parse()?);
    set_log_level(LogLevel::Error);
    Config::setup_global_config_from_file(&FilePath::new(domain.as_bytes())?)?;
    let node = NodeBuilder::new().signal_handling_mode(SignalHandlingMode::Disabled).create::<ipc::Service>()?;
    let chain = Chain { node, buffer: buffer.parse()? };
    match role.as_str() {
        "source" => source(&chain, count, period),
        "relay" if index < stages => relay(&chain, index, count),
        "sink" => sink(&chain, stages - 1, count),
        _ => Err("unknown role".into()),
    }
}

/// Publishes and waits for its reader, both at the start and at the end.
fn source(chain: &Chain, count: u64, period: u64) -> Result<(), AnyError> {
    let service = chain.service(0)?;
    let publisher =
        service.publisher_builder().backpressure_strategy(BackpressureStrategy::RetryUntilDelivered).create()?;
    while service.dynamic_config().number_of_subscribers() == 0 {
        std::thread::sleep(Duration::from_millis(1));
    }
    // Readers further down need the same moment; they come up within it.
    std::thread::sleep(Duration::from_millis(200));
    let start = monotonic_ns();
    for seq in 1..=count {
        if period > 0 {
            let due = start + seq * period;
            let now = monotonic_ns();
            if due > now {
                std::thread::sleep(Duration::from_nanos(due - now));
            }
        }
        let sample = publisher.loan_uninit()?;
        sample.write_payload(Message { seq, sent_ns: monotonic_ns(), rest: [seq; WORDS - 2] }).send()?;
    }
    while service.dynamic_config().number_of_subscribers() > 0 {
        std::thread::sleep(Duration::from_millis(1));
    }
    Ok(())
}

fn relay(chain: &Chain, index: usize, count: u64) -> Result<(), AnyError> {
    let input = chain.service(index - 1)?;
    let output = chain.service(index)?;
    let publisher =
        output.publisher_builder().backpressure_strategy(BackpressureStrategy::RetryUntilDelivered).create()?;
    while output.dynamic_config().number_of_subscribers() == 0 {
        std::thread::sleep(Duration::from_millis(1));
    }
    let subscriber = input.subscriber_builder().buffer_size(chain.buffer).create()?;
    let mut seen = 0;
    while seen < count {
        match subscriber.receive()? {
            None => std::thread::yield_now(),
            Some(sample) => {
                publisher.loan_uninit()?.write_payload(*sample.payload()).send()?;
                seen = sample.payload().seq;
            }
        }
    }
    drop(subscriber);
    while output.dynamic_config().number_of_subscribers() > 0 {
        std::thread::sleep(Duration::from_millis(1));
    }
    Ok(())
}

fn sink(chain: &Chain, edge: usize, count: u64) -> Result<(), AnyError> {
    let subscriber = chain.service(edge)?.subscriber_builder().buffer_size(chain.buffer).create()?;
    let mut latency = Histogram::<u64>::new_with_bounds(1, 100_000_000_000, 3)?;
    let (mut first, mut last, mut seen) = (0, 0, 0);
    while last < count {
        match subscriber.receive()? {
            None => std::thread::yield_now(),
            Some(sample) => {
                let message = sample.payload();
                let now = monotonic_ns();
                if first == 0 {
                    first = now;
                }
                latency.saturating_record(now.saturating_sub(message.sent_ns).max(1));
                seen += 1;
                last = message.seq;
                if last != seen {
                    return Err(format!("bare chain lost samples: number {last} came as {seen}").into());
                }
            }
        }
    }
    let seconds = (monotonic_ns() - first) as f64 / 1e9;
    let us = |q: f64| latency.value_at_quantile(q) as f64 / 1e3;
    println!(
        "{}",
        serde_json::json!({ "samples": seen, "seconds": seconds, "p50_us": us(0.5), "p99_us": us(0.99),
            "p999_us": us(0.999), "max_us": latency.max() as f64 / 1e3, "bytes": size_of::<Message>() })
    );
    Ok(())
}

fn main() -> ExitCode {
    match run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(e) => {
            eprintln!("lacuna-bare-chain: {e}");
            ExitCode::FAILURE
        }
    }
}
