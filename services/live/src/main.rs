//! The live view's process: the bus to a WebSocket.

use foxglove::websocket::Status;
use foxglove::{ChannelBuilder, Context, PartialMetadata, RawChannel, Schema, WebSocketServer, WebSocketServerHandle};
use lacuna_interfaces::BadInput;
use lacuna_interfaces::graph::Mode;
use lacuna_live::{Config, Thinner};
use lacuna_recorder::{Lanes, Topics, WriteError};
use lacuna_recording::container::{Channel, ChannelId};
use lacuna_recording::topics::{Declare, Messages};
use lacuna_stage::{AnyMessage, Sink, SinkContext, run_sink};
use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::process::ExitCode;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Lost samples are said at most this often.
const SAY_EVERY: Duration = Duration::from_secs(2);

/// The channels that viewers can subscribe to.
struct Board {
    context: Arc<Context>,
    channels: Vec<Arc<RawChannel>>,
    /// The message under way.
    bytes: Vec<u8>,
}

impl Declare for Board {
    fn channel(&mut self, channel: Channel) -> Result<ChannelId, WriteError> {
        let refuse = |what: String| WriteError::from(BadInput::new(what));
        let number = u16::try_from(self.channels.len()).map_err(|_| refuse("more than 65536 topics".to_owned()))?;
        let made = ChannelBuilder::new(channel.topic.as_str())
            .context(&self.context)
            .message_encoding(channel.encoding)
            .schema(Schema::new(channel.schema, channel.schema_encoding, channel.schema_text))
            .build_raw()
            .map_err(|e| refuse(format!("topic {}: cannot be shown: {e}", channel.topic)))?;
        self.channels.push(made);
        Ok(ChannelId::new(number))
    }
}

impl Messages for Board {
    fn message(&mut self, channel: ChannelId, _sequence: u32, time_ns: u64, fill: impl FnOnce(&mut Vec<u8>)) {
        // Nobody watches this topic: nothing to do.
        let Some(channel) = self.channels.get(usize::from(channel.number())).filter(|c| c.has_sinks()) else { return };
        self.bytes.clear();
        fill(&mut self.bytes);
        channel.log_with_meta(&self.bytes, PartialMetadata::with_log_time(time_ns));
    }
}

struct View {
    server: WebSocketServerHandle,
    address: SocketAddr,
    board: Board,
    lanes: Lanes,
    /// The topics of each lane.
    topics: Vec<Topics>,
    thinners: BTreeMap<String, Thinner>,
    /// Samples that did not reach the view, and how many of them were said.
    missing: u64,
    said: u64,
    said_at: Instant,
}

impl View {
    /// Tells viewers and the log of samples that the graph dropped rather than wait for this view.
    fn say_missing(&mut self) {
        if self.missing > self.said && self.said_at.elapsed() > SAY_EVERY {
            self.said_at = Instant::now();
            self.said = self.missing;
            let what = format!("{} samples were lost on their way to the live view", self.missing);
            tracing::warn!("{what}");
            self.server.publish_status(Status::warning(what));
        }
    }
}

impl Sink for View {
    type Config = Config;

    fn new(config: Config, context: &SinkContext<'_>) -> Result<Self, BadInput> {
        config.check()?;
        if context.mode == Mode::Replay {
            return Err(BadInput::new(format!(
                "live view: graph \"{}\" is a replay, which waits for its slowest reader; expected mode = \"live\", as in launch/view.toml",
                context.graph.name
            )));
        }
        let lanes = Lanes::of(context.topics)?;
        let mut board = Board { context: Context::new(), channels: Vec::new(), bytes: Vec::new() };
        let branches = lanes.branches.iter().map(|b| (b.namespace.as_str(), b.streams.as_slice()));
        let mut topics = Vec::new();
        // Lane 0 is the one without a namespace, even where nothing comes in it.
        for (namespace, streams) in [("", lanes.streams.as_slice())].into_iter().chain(branches) {
            let declared = Topics::declare(&mut board, &context.robot.joints, namespace, streams);
            topics.push(declared.map_err(|e| BadInput::new(e.to_string()))?);
        }
        let asked = SocketAddr::new(config.address, config.port);
        let server = WebSocketServer::new()
            .name(format!("lacuna {}", context.graph.name))
            .context(&board.context)
            .bind(config.address.to_string(), config.port)
            .message_backlog_size(config.backlog)
            .start_blocking()
            .map_err(|e| BadInput::new(format!("live view: cannot listen on {asked}: {e}; expected a free port")))?;
        let address = SocketAddr::new(config.address, server.port());
        tracing::info!("viewers connect to ws://{address}");
        if !config.address.is_loopback() {
            tracing::warn!(
                "whoever reaches {address} can read the robot's data: it is neither encrypted nor protected"
            );
        }
        let thinners = context.topics.iter().map(|(t, _)| (t.clone(), Thinner::new(config.rate_hz))).collect();
        Ok(Self { server, address, board, lanes, topics, thinners, missing: 0, said: 0, said_at: Instant::now() })
    }

    fn take(&mut self, topic: &str, message: AnyMessage<'_>, missing: u64) -> Result<(), String> {
        self.missing += missing;
        let alarm = if let AnyMessage::ResidualWatch(m) = message { m.alarm } else { 0 };
        if !self.thinners.get_mut(topic).is_some_and(|t| t.shows(message.header(), alarm)) {
            return Ok(());
        }
        let Some(topics) = self.topics.get(self.lanes.index_of(topic)) else { return Ok(()) };
        match message {
            AnyMessage::JointMeasured(m) => topics.measured(m, &mut self.board),
            AnyMessage::JointSmoothed(m) => topics.smoothed(m, &mut self.board),
            AnyMessage::TorqueModel(m) => topics.torque(m, &mut self.board),
            AnyMessage::FrictionTorque(m) => topics.friction(m, &mut self.board),
            AnyMessage::PayloadEstimate(m) => topics.payload(m, &mut self.board),
            AnyMessage::ResidualWatch(m) => topics.watch(m, &mut self.board),
        }
        self.say_missing();
        Ok(())
    }

    fn idle(&mut self) {
        self.say_missing();
    }

    fn finish(self, complete: bool) -> Result<serde_json::Value, String> {
        let count = |of: fn(&Thinner) -> u64| -> BTreeMap<&str, u64> {
            self.thinners.iter().map(|(topic, t)| (topic.as_str(), of(t))).collect()
        };
        let report = serde_json::json!({
            "address": format!("ws://{}", self.address),
            "viewers": self.server.client_count(),
            "shown": count(|t| t.shown),
            "passed_over": count(|t| t.passed_over),
            "complete": complete,
        });
        self.server.stop().wait_blocking();
        Ok(report)
    }
}

fn main() -> ExitCode {
    run_sink::<View>()
}
