//! Many sites as a job array: one task a site, since the fold needs a site's rods together.
//!
//! * [`identity`] files known by size, first and last bytes, or by all of them
//! * [`task`]     one line of a plan, and the name of its result
//! * [`part`]     a share of a site's search
//! * [`plan`]     an archive's folders and their configurations as tasks
//! * [`collect`]  results of all tasks in one database

pub mod collect;
pub mod identity;
pub mod part;
pub mod plan;
pub mod task;
