//! Processors and real-time priority of a stage process.

use crate::process::Failure;
use lacuna_interfaces::graph::Node;
use rustix::thread::{CpuSet, sched_setaffinity};
use thread_priority::{
    RealtimeThreadSchedulePolicy, ThreadPriority, ThreadSchedulePolicy, set_thread_priority_and_policy,
    thread_native_id,
};

/// Gives the calling thread, and those it starts from now on, what the node asks for. What cannot be had is an error:
/// a machine that was tuned must not run untuned without anybody noticing.
///
/// # Errors
/// [`Failure::Usage`] if the processor does not exist or the right to a priority is missing.
pub fn apply(node: &Node) -> Result<(), Failure> {
    if !node.cpus.is_empty() {
        let mut set = CpuSet::new();
        node.cpus.iter().for_each(|&cpu| set.set(cpu));
        sched_setaffinity(None, &set).map_err(|e| {
            Failure::usage(format!(
                "node \"{}\": cpus: cannot run on {:?}: {e}; expected processors of this machine",
                node.name, node.cpus
            ))
        })?;
    }
    let Some(priority) = node.priority else { return Ok(()) };
    let refused = |e: &dyn std::fmt::Debug| {
        Failure::usage(format!(
            "node \"{}\": priority: cannot have SCHED_FIFO {priority} ({e:?}); expected the right to it (CAP_SYS_NICE, or an rtprio limit of at least {priority})",
            node.name
        ))
    };
    let level = ThreadPriority::try_from(priority).map_err(|e| refused(&e))?;
    let policy = ThreadSchedulePolicy::Realtime(RealtimeThreadSchedulePolicy::Fifo);
    set_thread_priority_and_policy(thread_native_id(), level, policy).map_err(|e| refused(&e))
}
