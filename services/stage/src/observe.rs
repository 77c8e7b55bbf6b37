//! Looking at the topics of a live graph that is running, without being part of it.

use crate::any::{AnyMessage, with_messages};
use crate::bus::{TapInput, tap_type};
use crate::domain::{Domain, RunDir};
use crate::process::Failure;
use lacuna_interfaces::graph::{GraphFile, Mode};
use lacuna_interfaces::{
    FrictionTorque, JointMeasured, JointSmoothed, PayloadEstimate, ResidualWatch, TorqueModel, Wire,
};

macro_rules! any_tap {
    ($($name:ident),*) => {
        enum AnyTap { $($name(TapInput<$name>),)* }

        impl AnyTap {
            fn open(domain: &Domain, topic: &str, type_name: &str) -> Result<Self, Failure> {
                $(if type_name == $name::type_name() {
                    return Ok(Self::$name(TapInput::open(domain, topic)?));
                })*
                Err(Failure::usage(format!(
                    "topic \"{topic}\": it carries {type_name}; expected a message of this version of Lacuna"
                )))
            }

            fn drain(&mut self, take: Take<'_>) -> Result<bool, Failure> {
                match self { $(Self::$name(tap) => {
                    let topic = tap.topic().to_owned();
                    tap.drain(&mut |m, missing| take(&topic, AnyMessage::$name(m), missing))
                })* }
            }
        }
    };
}

with_messages!(any_tap);

/// Hears topic, message, and how many samples were lost before it.
pub type Take<'a> = &'a mut dyn FnMut(&str, AnyMessage<'_>, u64) -> Result<(), Failure>;

/// An observer of some topics of a run.
pub struct Observer {
    taps: Vec<Option<AnyTap>>,
    /// The place on the bus; goes last.
    _domain: Domain,
}

impl Observer {
    /// Attaches to `topics` of a running graph; to all of them if the list is empty.
    ///
    /// # Errors
    /// [`Failure`] for a replay, whose lossless edges an observer would hold up; for a topic the graph does not have; and
    /// if the bus refuses.
    pub fn attach(run: &RunDir, topics: &[String]) -> Result<Self, Failure> {
        let graph = run.graph()?;
        if graph.mode == Mode::Replay {
            return Err(Failure::usage(format!(
                "graph \"{}\": found a replay, whose topics lose nothing and which an observer would hold up; expected a \
                 live graph, or the recording that the replay writes",
                graph.name
            )));
        }
        let wanted = chosen(&graph, topics)?;
        let domain = Domain::join(run, &format!("observer-{}", std::process::id()))?;
        let mut taps = Vec::new();
        for topic in wanted {
            let type_name = tap_type(topic).ok_or_else(|| {
                Failure::usage(format!(
                    "topic \"{topic}\": its writer has not opened it for observers; expected a stage of Lacuna"
                ))
            })?;
            let tap = AnyTap::open(&domain, topic, &type_name).or_else(|_| {
                // Observers that were killed hold their places until somebody cleans up after them.
                domain.clean_dead_nodes();
                AnyTap::open(&domain, topic, &type_name)
            })?;
            taps.push(Some(tap));
        }
        Ok(Self { taps, _domain: domain })
    }

    /// Hands over every sample that is there; `true` once all topics have ended.
    ///
    /// # Errors
    /// [`Failure`] if the bus fails, or `take` does.
    pub fn drain(&mut self, take: Take<'_>) -> Result<bool, Failure> {
        for slot in &mut self.taps {
            if let Some(tap) = slot
                && tap.drain(take)?
            {
                *slot = None;
            }
        }
        Ok(self.taps.iter().all(Option::is_none))
    }
}

fn chosen<'a>(graph: &'a GraphFile, topics: &'a [String]) -> Result<Vec<&'a str>, Failure> {
    let written: Vec<&str> = graph.nodes.iter().filter_map(|n| n.output.as_deref()).collect();
    if topics.is_empty() {
        return Ok(written);
    }
    let find = |topic: &'a String| {
        // A recording's name of the topic is understood too.
        let bare = topic.trim_start_matches('/');
        written.iter().find(|w| **w == bare).copied().ok_or_else(|| {
            Failure::usage(format!("topic \"{topic}\": found no such topic; expected one of {}", written.join(", ")))
        })
    };
    topics.iter().map(find).collect()
}
