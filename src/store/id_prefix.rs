//! Prefixes of identifiers.

use crate::wire::names;

names! {
    /// What an identifier names, by its prefix.
    #[derive(Clone, Copy, Debug, PartialEq, Eq)]
    pub(super) enum IdPrefix {
        MeasurementSet = "set",
        Frames = "frm",
        /// A column mapping.
        Columns = "col",
        /// A work frame or a tool.
        Document = "doc",
        /// A reference of an instrument.
        Reference = "ref",
        Robot = "rob",
        Job = "job",
        ParameterSet = "par",
        Network = "net",
        Key = "key",
    }
}

impl IdPrefix {
    /// A new identifier: the prefix and a UUID of version 7. Ids of one process sort by age.
    pub(super) fn new_id(self) -> String {
        format!("{}_{}", self.as_str(), uuid::Uuid::now_v7().simple())
    }

    /// The prefix of an identifier of this service.
    pub(super) fn from_id(id: &str) -> Option<Self> {
        let prefix = id.split_once('_')?.0;
        Self::ALL.into_iter().find(|kind| kind.as_str() == prefix)
    }
}
