//! Tables of any form: from the bytes of a file to points.

mod cells;
pub(super) mod checks;
pub mod columns;
pub mod decimal_mark;
mod endless_rows;
mod groups;
mod halves;
mod header;
mod lines;
mod other_layouts;
pub mod own_form;
mod plain;
pub mod points;
mod quotes;
mod raw;
mod resolution;
mod rows;
mod second_readings;
pub mod targets;
pub mod text;

pub use raw::{MAX_COLUMNS, Next, Table, TableRow};
