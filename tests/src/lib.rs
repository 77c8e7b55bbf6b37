//! Helpers of the process tests, and stand-in stages that show any executable can take a box of the graph.
