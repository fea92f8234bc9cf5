//! `[simulation]`: what `tirante simulate` writes.

use super::RodConfig;
use super::reader::Table;
use crate::synthesis::Simulation;

pub(super) fn read(_table: &mut Table<'_>, _rods: &[Option<RodConfig>]) -> Option<Simulation> {
    Some(Simulation {})
}
