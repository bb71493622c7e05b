mod core;
pub(crate) use core::{Core, Incoming, Rules, VERTICES_PER_PATCH, What};
