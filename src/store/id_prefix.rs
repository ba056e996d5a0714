//! Prefixes of identifiers.

use crate::wire::names;

/// What an identifier names, by its prefix.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum IdPrefix {
    /// A measurement set.
    MeasurementSet,
    /// Frames from sweeps.
    Frames,
    /// A column mapping.
    Columns,
    /// A work frame or a tool.
    Document,
    /// A reference of an instrument.
    Reference,
    /// A robot.
    Robot,
    /// A job.
    Job,
    /// A parameter set.
    ParameterSet,
    /// A network.
    Network,
    /// An API key.
    Key,
}

names!(IdPrefix {
    MeasurementSet = "set",
    Frames = "frm",
    Columns = "col",
    Document = "doc",
    Reference = "ref",
    Robot = "rob",
    Job = "job",
    ParameterSet = "par",
    Network = "net",
    Key = "key"
});

impl IdPrefix {
    /// A new identifier: the prefix and a UUID of version 7. Ids of one process sort by age.
    pub(super) fn new_id(self) -> String {
        format!("{}_{}", self.as_str(), uuid::Uuid::now_v7().simple())
    }

    /// The prefix of an identifier of this service.
    pub(super) fn of(id: &str) -> Option<Self> {
        let prefix = id.split_once('_')?.0;
        Self::ALL.into_iter().find(|kind| kind.as_str() == prefix)
    }
}
