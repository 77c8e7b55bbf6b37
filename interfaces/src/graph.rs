//! `launch/*.toml`: a process graph as data. Which executables run, what each reads and writes, how it is
//! configured and what happens when it ends.
//!
//! Strings may hold `${key}`; keys come from `[set]` and are overridden by `lacuna up GRAPH --set key=value`.
//!
//! # Branches
//! A topic may stand in a namespace, `before/torque`: then two chains of the same stages run beside each other on one
//! recording, and their messages stay apart on the bus and in the recording. The nodes that write into a namespace
//! are a branch; a branch may have a model file of its own.

use crate::BadInput;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Processor numbers a node can name are below this (the size of the kernel's usual set).
pub const MAX_CPUS: usize = 1024;

/// What an edge promises.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Mode {
    /// Lossless: a slow reader holds back its writer.
    Replay,
    /// Never waits: what a reader cannot take is dropped and counted.
    Live,
}

/// When a node that ended is started again.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Restart {
    /// Not at all: if it fails, the run fails.
    #[default]
    Never,
    /// After a failure (live graphs only: a replay is a transaction).
    OnFailure,
    /// Whenever it ends before what it reads does (live graphs only); a source that reached its end stays ended.
    Always,
}

/// A node: one process.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Node {
    /// Name, unique in the graph.
    pub name: String,
    /// Executable: a name looked up beside `lacuna`, or a path.
    pub exec: String,
    /// Further arguments, before the harness's own.
    #[serde(default)]
    pub args: Vec<String>,
    /// Topics it reads.
    #[serde(default)]
    pub inputs: Vec<String>,
    /// Topic it writes, if any: a name, or `namespace/name`.
    pub output: Option<String>,
    /// Model file of this node; absent: the graph's. Nodes that write into one namespace have one model.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub model: Option<String>,
    /// Messages each of its inputs can hold; absent: the graph's `buffer`. A reader that may fall behind for a moment,
    /// as a recorder does when its disk is busy, wants more than the stages between it and the robot.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub buffer: Option<usize>,
    /// Restart policy.
    #[serde(default)]
    pub restart: Restart,
    /// First pause before a restart [ms]; doubles up to 64 times itself.
    #[serde(default = "default_backoff")]
    pub backoff_ms: u64,
    /// Real-time priority (SCHED_FIFO) of the process, 1 to 99; without it the operating system's usual scheduling.
    /// Threads that the stage starts later have it too.
    pub priority: Option<u8>,
    /// Processors the process may run on; empty for all.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub cpus: Vec<usize>,
    /// The stage's configuration, passed as it is.
    #[serde(default)]
    pub config: toml::Table,
}

impl Node {
    /// Namespace that it writes into; empty for none.
    pub fn namespace(&self) -> &str {
        self.output.as_deref().map_or("", |topic| split_topic(topic).0)
    }
}

/// Namespace and name of a topic; the namespace is empty for a topic of none.
pub fn split_topic(topic: &str) -> (&str, &str) {
    topic.split_once('/').unwrap_or(("", topic))
}

fn default_backoff() -> u64 {
    5
}

/// The whole file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GraphFile {
    /// Name for messages and recordings.
    pub name: String,
    /// Replay or live edges.
    pub mode: Mode,
    /// Messages an edge can hold; 512 measured best for replay.
    #[serde(default = "default_buffer")]
    pub buffer: usize,
    /// Robot file; may hold `${…}`.
    #[serde(default)]
    pub robot: String,
    /// Model file; empty for none.
    #[serde(default)]
    pub model: String,
    /// Keys for `${…}` with their defaults; an empty default means the user must set it.
    #[serde(default)]
    pub set: BTreeMap<String, toml::Value>,
    /// Nodes, in the order of the stream.
    #[serde(rename = "node")]
    pub nodes: Vec<Node>,
}

fn default_buffer() -> usize {
    512
}

impl GraphFile {
    /// Parses a graph file; `${…}` stay as they are until [`GraphFile::resolve`].
    ///
    /// # Errors
    /// [`BadInput`] with the line.
    pub fn parse(text: &str) -> Result<Self, BadInput> {
        toml::from_str(text).map_err(|e| BadInput::from_toml(&e, text))
    }

    /// Fills in `${key}` from `[set]` and `overrides`, then checks the graph. A string that is exactly one
    /// `${key}` takes the key's value with its type (number, list, …).
    ///
    /// # Errors
    /// [`BadInput`] for an unknown key, a key left empty, or a graph that does not hang together.
    pub fn resolve(mut self, overrides: &[(String, String)]) -> Result<Self, BadInput> {
        for (key, value) in overrides {
            let Some(slot) = self.set.get_mut(key) else {
                let known: Vec<&str> = self.set.keys().map(String::as_str).collect();
                return Err(BadInput::new(format!("--set {key}: no such key; this graph knows {}", known.join(", "))));
            };
            *slot = override_value(slot, key, value)?;
        }
        let set = std::mem::take(&mut self.set);
        let text = |s: &str, place: &str| -> Result<String, BadInput> {
            match substitute(s, &set, place)? {
                toml::Value::String(s) => Ok(s),
                other => Ok(other.to_string()),
            }
        };
        self.robot = text(&self.robot, "robot")?;
        self.model = text(&self.model, "model")?;
        for node in &mut self.nodes {
            let place = format!("node \"{}\"", node.name);
            node.exec = text(&node.exec, &place)?;
            if let Some(model) = &mut node.model {
                *model = text(model, &place)?;
            }
            for arg in &mut node.args {
                *arg = text(arg, &place)?;
            }
            let mut config = toml::Value::Table(std::mem::take(&mut node.config));
            substitute_all(&mut config, &set, &place)?;
            if let toml::Value::Table(table) = config {
                node.config = table;
            }
        }
        self.set = set;
        self.validate()?;
        Ok(self)
    }

    /// Names of the nodes that read `topic`.
    pub fn readers<'a>(&'a self, topic: &'a str) -> impl Iterator<Item = &'a Node> {
        self.nodes.iter().filter(move |n| n.inputs.iter().any(|t| t == topic))
    }

    /// Messages that an input of `node` can hold.
    pub fn buffer_of(&self, node: &Node) -> usize {
        node.buffer.unwrap_or(self.buffer)
    }

    /// Messages that the readers of `topic` can hold: the fewest and the most.
    pub fn buffers(&self, topic: &str) -> (usize, usize) {
        let each = || self.readers(topic).map(|n| self.buffer_of(n));
        (each().min().unwrap_or(self.buffer), each().max().unwrap_or(self.buffer))
    }

    /// Model file of `node`; empty for none.
    pub fn model_of<'a>(&'a self, node: &'a Node) -> &'a str {
        node.model.as_deref().unwrap_or(&self.model)
    }

    /// Model file of every namespace whose nodes have another than the graph's, in the order of the nodes.
    pub fn branch_models(&self) -> Vec<(&str, &str)> {
        let mut found: Vec<(&str, &str)> = Vec::new();
        for node in &self.nodes {
            let branch = (node.namespace(), self.model_of(node));
            if branch.1 != self.model && !branch.1.is_empty() && !found.contains(&branch) {
                found.push(branch);
            }
        }
        found
    }

    /// The graph with the named nodes only; edges to nodes left out are cut.
    ///
    /// # Errors
    /// [`BadInput`] for an unknown name, or for a node that would read a topic nobody writes.
    pub fn only(mut self, names: &[String]) -> Result<Self, BadInput> {
        for name in names {
            if !self.nodes.iter().any(|n| &n.name == name) {
                let known: Vec<&str> = self.nodes.iter().map(|n| n.name.as_str()).collect();
                return Err(BadInput::new(format!("--only {name}: no such node; this graph has {}", known.join(", "))));
            }
        }
        self.nodes.retain(|n| names.contains(&n.name));
        let written: Vec<String> = self.nodes.iter().filter_map(|n| n.output.clone()).collect();
        for node in &mut self.nodes {
            let had_inputs = !node.inputs.is_empty();
            node.inputs.retain(|t| written.contains(t));
            if had_inputs && node.inputs.is_empty() {
                return Err(BadInput::new(format!(
                    "--only: node \"{}\" would have no input left; add the nodes before it",
                    node.name
                )));
            }
        }
        self.validate()?;
        Ok(self)
    }

    fn validate(&self) -> Result<(), BadInput> {
        if self.nodes.is_empty() {
            return Err(BadInput::new("found no [[node]]; expected at least one"));
        }
        valid_buffer("", self.buffer)?;
        let mut written: Vec<&str> = Vec::new();
        for (i, node) in self.nodes.iter().enumerate() {
            valid_name("node name", &node.name)?;
            if self.nodes[..i].iter().any(|n| n.name == node.name) {
                return Err(BadInput::new(format!(
                    "node \"{}\": the name is given twice; expected distinct names",
                    node.name
                )));
            }
            if node.restart != Restart::Never && self.mode == Mode::Replay {
                return Err(BadInput::new(format!(
                    "node \"{}\": restart is for live graphs; a replay with a restarted stage would not be the recording any more",
                    node.name
                )));
            }
            node.validate_scheduling()?;
            if let Some(buffer) = node.buffer {
                valid_buffer(&format!("node \"{}\": ", node.name), buffer)?;
            }
            for (k, topic) in node.inputs.iter().enumerate() {
                if node.inputs[..k].contains(topic) {
                    return Err(BadInput::new(format!("node \"{}\": reads topic \"{topic}\" twice", node.name)));
                }
                if !written.contains(&topic.as_str()) {
                    return Err(BadInput::new(format!(
                        "node \"{}\": reads topic \"{topic}\", which no node before it writes",
                        node.name
                    )));
                }
            }
            if let Some(topic) = &node.output {
                valid_topic(topic)?;
                if written.contains(&topic.as_str()) {
                    return Err(BadInput::new(format!(
                        "node \"{}\": topic \"{topic}\" has a writer already; expected one writer a topic",
                        node.name
                    )));
                }
                written.push(topic);
            }
            self.one_model_a_branch(i, node)?;
        }
        Ok(())
    }

    /// A recording holds one model file for each namespace, so there must not be two.
    fn one_model_a_branch(&self, index: usize, node: &Node) -> Result<(), BadInput> {
        let space = node.namespace();
        if space.is_empty() {
            return match &node.model {
                Some(_) => Err(BadInput::new(format!(
                    "node \"{}\": has a model of its own; expected its output in a namespace, as in \"before/torque\"",
                    node.name
                ))),
                None => Ok(()),
            };
        }
        match self.nodes[..index].iter().find(|n| n.namespace() == space && self.model_of(n) != self.model_of(node)) {
            Some(other) => Err(BadInput::new(format!(
                "node \"{}\": found model \"{}\"; expected \"{}\", that of node \"{}\" in the same namespace",
                node.name,
                self.model_of(node),
                self.model_of(other),
                other.name
            ))),
            None => Ok(()),
        }
    }
}

fn valid_buffer(place: &str, buffer: usize) -> Result<(), BadInput> {
    if (1..=65_536).contains(&buffer) {
        return Ok(());
    }
    Err(BadInput::new(format!("{place}buffer: found {buffer}; expected 1 to 65536")))
}

fn valid_topic(topic: &str) -> Result<(), BadInput> {
    match topic.split_once('/') {
        Some((space, name)) => valid_name("topic's namespace", space).and_then(|()| valid_name("topic", name)),
        None => valid_name("topic", topic),
    }
}

impl Node {
    fn validate_scheduling(&self) -> Result<(), BadInput> {
        let bad = |what: String| Err(BadInput::new(format!("node \"{}\": {what}", self.name)));
        if let Some(priority) = self.priority
            && !(1..=99).contains(&priority)
        {
            return bad(format!("priority: found {priority}; expected 1 (lowest) to 99"));
        }
        match self.cpus.iter().find(|&&cpu| cpu >= MAX_CPUS) {
            Some(cpu) => bad(format!("cpus: found {cpu}; expected processor numbers below {MAX_CPUS}")),
            None => Ok(()),
        }
    }
}

fn valid_name(what: &str, name: &str) -> Result<(), BadInput> {
    let ok =
        !name.is_empty() && name.len() <= 64 && name.chars().all(|c| c.is_ascii_alphanumeric() || c == '_' || c == '-');
    if ok {
        Ok(())
    } else {
        Err(BadInput::new(format!("{what}: found \"{name}\"; expected letters, digits, '_' or '-', at most 64")))
    }
}

/// A `--set` value with the type of the default it replaces; a string stays a string whatever it looks like.
fn override_value(default: &toml::Value, key: &str, value: &str) -> Result<toml::Value, BadInput> {
    if default.is_str() {
        return Ok(toml::Value::String(value.to_owned()));
    }
    let parsed = toml::from_str::<toml::Table>(&format!("v = {value}")).ok().and_then(|mut t| t.remove("v"));
    let parsed = match (default, parsed) {
        (toml::Value::Float(_), Some(toml::Value::Integer(i))) => Some(toml::Value::Float(i as f64)),
        (_, p) => p,
    };
    match parsed {
        Some(v) if v.same_type(default) => Ok(v),
        _ => Err(BadInput::new(format!(
            "--set {key}={value}: expected a {} like the default {default}",
            default.type_str()
        ))),
    }
}

fn substitute(s: &str, set: &BTreeMap<String, toml::Value>, place: &str) -> Result<toml::Value, BadInput> {
    let lookup =
        |key: &str| set.get(key).ok_or_else(|| BadInput::new(format!("{place}: ${{{key}}} is not a key of [set]")));
    if let Some(key) = s.strip_prefix("${").and_then(|r| r.strip_suffix('}'))
        && !key.contains('}')
    {
        return lookup(key).cloned();
    }
    let mut out = String::new();
    let mut rest = s;
    while let Some(start) = rest.find("${") {
        let Some(len) = rest[start..].find('}') else {
            return Err(BadInput::new(format!("{place}: \"{s}\" opens ${{ without closing it")));
        };
        out.push_str(&rest[..start]);
        match lookup(&rest[start + 2..start + len])? {
            toml::Value::String(v) => out.push_str(v),
            other => out.push_str(&other.to_string()),
        }
        rest = &rest[start + len + 1..];
    }
    out.push_str(rest);
    Ok(toml::Value::String(out))
}

fn substitute_all(value: &mut toml::Value, set: &BTreeMap<String, toml::Value>, place: &str) -> Result<(), BadInput> {
    match value {
        toml::Value::String(s) => *value = substitute(s, set, place)?,
        toml::Value::Array(items) => {
            for item in items {
                substitute_all(item, set, place)?;
            }
        }
        toml::Value::Table(table) => {
            for (_, item) in table.iter_mut() {
                substitute_all(item, set, place)?;
            }
        }
        _ => {}
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    const GRAPH: &str = "name = \"g\"\nmode = \"replay\"\nrobot = \"${robot}\"\n[set]\nrobot = \"r.toml\"\nrate = 1.5\n\
        [[node]]\nname = \"source\"\nexec = \"lacuna-source\"\noutput = \"measured\"\nconfig = { rate = \"${rate}\", file = \"a-${rate}.csv\" }\n\
        [[node]]\nname = \"smoother\"\nexec = \"lacuna-smoother\"\ninputs = [\"measured\"]\noutput = \"smoothed\"\n";

    fn set(key: &str, value: &str) -> Vec<(String, String)> {
        vec![(key.to_owned(), value.to_owned())]
    }

    #[test]
    fn substitution_keeps_types() {
        let g = GraphFile::parse(GRAPH).unwrap().resolve(&set("rate", "2")).unwrap();
        assert_eq!(g.robot, "r.toml");
        assert_eq!(g.nodes[0].config["rate"], toml::Value::Float(2.0));
        assert_eq!(g.nodes[0].config["file"].as_str(), Some("a-2.0.csv"));
    }

    #[test]
    fn a_reader_may_have_a_buffer_of_its_own() {
        let text = GRAPH.to_owned() + "buffer = 4096\n[[node]]\nname = \"r\"\nexec = \"x\"\ninputs = [\"measured\"]\n";
        let g = GraphFile::parse(&text).unwrap().resolve(&[]).unwrap();
        assert_eq!((g.buffers("measured"), g.buffers("smoothed")), ((512, 4096), (512, 512)));
        let e = GraphFile::parse(&text.replace("4096", "0")).unwrap().resolve(&[]).unwrap_err();
        assert!(e.to_string().contains("node \"smoother\": buffer: found 0"), "{e}");
    }

    #[test]
    fn bad_graphs_are_refused_in_words() {
        let cases = [
            (GRAPH.to_owned(), set("rat", "2"), "no such key"),
            (GRAPH.to_owned(), set("rate", "fast"), "float"),
            (GRAPH.replace("inputs = [\"measured\"]", "inputs = [\"x\"]"), vec![], "no node before it writes"),
            (GRAPH.replace("output = \"smoothed\"", "output = \"measured\""), vec![], "has a writer already"),
            (GRAPH.replace("name = \"smoother\"", "name = \"source\""), vec![], "given twice"),
            (GRAPH.replace("output = \"smoothed\"", "restart = \"always\""), vec![], "live graphs"),
            (GRAPH.replace("${robot}", "${robo}"), vec![], "not a key"),
        ];
        for (text, overrides, expect) in cases {
            let e = GraphFile::parse(&text).and_then(|g| g.resolve(&overrides)).unwrap_err();
            assert!(e.what.contains(expect), "expected '{expect}' in '{e}'");
        }
        assert_eq!(GraphFile::parse(&GRAPH.replace("mode", "mood")).unwrap_err().line, Some(2));
    }

    #[test]
    fn a_namespace_has_one_model() {
        let node = |name: &str, input: &str, output: &str, model: &str| {
            format!("[[node]]\nname = \"{name}\"\nexec = \"x\"\ninputs = [\"{input}\"]\noutput = \"{output}\"\n{model}")
        };
        let graph =
            |nodes: &[String]| GraphFile::parse(&(GRAPH.to_owned() + &nodes.concat())).and_then(|g| g.resolve(&[]));
        let old = node("a", "smoothed", "old/torque", "");
        let new = node("b", "smoothed", "new/torque", "model = \"m-${rate}.toml\"\n");
        let g = graph(&[old.clone(), new.clone()]).unwrap();
        assert_eq!(g.branch_models(), [("new", "m-1.5.toml")]);
        assert_eq!((g.nodes[2].namespace(), g.model_of(&g.nodes[2])), ("old", ""));
        let e = graph(&[old.clone(), new, node("c", "new/torque", "new/friction", "")]).unwrap_err().what;
        assert!(e.contains("that of node \"b\""), "{e}");
        let e = graph(&[node("b", "smoothed", "torque", "model = \"m\"\n")]).unwrap_err().what;
        assert!(e.contains("in a namespace"), "{e}");
        for topic in ["a/b/c", "/a", "a/", "a b"] {
            assert!(graph(&[node("b", "smoothed", topic, "")]).is_err(), "{topic}");
        }
    }

    #[test]
    fn only_cuts_edges() {
        let g = GraphFile::parse(GRAPH).unwrap().resolve(&[]).unwrap();
        assert_eq!(g.clone().only(&["source".to_owned()]).unwrap().nodes.len(), 1);
        assert!(g.only(&["smoother".to_owned()]).unwrap_err().what.contains("no input left"));
    }
}
