//! Holds the counts of a run against each other.

use lacuna_interfaces::graph::GraphFile;
use serde::{Deserialize, Serialize};
use serde_json::Value;

/// One topic: what its writer says and what its readers say.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Edge {
    /// Topic.
    pub topic: String,
    /// Samples its writer published.
    pub published: u64,
    /// Deliveries the writer counted as dropped.
    pub dropped: u64,
    /// Samples that did not arrive, all readers together.
    pub gaps: u64,
}

/// All topics of a run without restarts, by its report and its graph.
pub fn edges(graph: &GraphFile, report: &Value) -> Vec<Edge> {
    let count = |node: &str, key: &str| report["nodes"][node][key].as_u64().unwrap_or(0);
    let of_writer = |w: &lacuna_interfaces::graph::Node| {
        let topic = w.output.clone()?;
        let published = count(&w.name, "published");
        let received = |r: &str| report["nodes"][r]["received"][&topic].as_u64().unwrap_or(0);
        let gaps = graph.readers(&topic).map(|r| published.saturating_sub(received(&r.name))).sum();
        Some(Edge { published, dropped: count(&w.name, "dropped"), gaps, topic })
    };
    graph.nodes.iter().filter_map(of_writer).collect()
}

/// The edges whose counts do not agree, in words.
pub fn disagreements(edges: &[Edge]) -> Vec<String> {
    let wrong = edges.iter().filter(|e| e.dropped != e.gaps);
    wrong
        .map(|e| format!("topic {}: its writer counted {} drops, its readers miss {}", e.topic, e.dropped, e.gaps))
        .collect()
}
