//! Queries of lists: page, order and filters.

use crate::http::Error;
use crate::store::{Cursor, ListRequest, PageRequest};
use crate::wire::job::Kind;
use crate::wire::job_answer::JobStatus;
use crate::wire::page::{ArchivedFilter, DEFAULT_PAGE, MAX_PAGE, Sort};
use crate::wire::parameter_set::ParameterSetStatus;
use serde::Deserialize;
use utoipa::IntoParams;

/// Longest text to search for, characters: that of the longest name.
const MAX_SEARCH: usize = 200;

fn invalid(detail: String) -> Error {
    Error::BadRequest {
        code: "invalid_query",
        detail,
    }
}

/// The part of the store's request that all lists have in common.
fn common(
    limit: Option<u32>,
    cursor: Option<&str>,
    archived: Option<ArchivedFilter>,
    sort: Option<Sort>,
    has_names: bool,
) -> Result<ListRequest, Error> {
    let limit = limit.unwrap_or(DEFAULT_PAGE);
    if !(1..=MAX_PAGE).contains(&limit) {
        return Err(invalid(format!(
            "limit is {limit}; 1 to {MAX_PAGE} is allowed"
        )));
    }
    let invalid_cursor = |detail: String| Error::BadRequest {
        code: "invalid_cursor",
        detail,
    };
    let cursor = cursor.map(str::parse::<Cursor>).transpose();
    let cursor =
        cursor.map_err(|e| invalid_cursor(format!("{e}: pass next_cursor on as it is")))?;
    let request = ListRequest {
        page: PageRequest { limit, cursor },
        sort: sort.unwrap_or_default(),
        archived: archived.unwrap_or_default(),
        ..ListRequest::default()
    };
    if request.sort.is_by_name() && !has_names {
        return Err(invalid(
            "items of this list have no names: sort by created_at or -created_at".into(),
        ));
    }
    if !request.is_consistent() {
        return Err(invalid_cursor(
            "the cursor belongs to another order of the list: start without a cursor".into(),
        ));
    }
    Ok(request)
}

/// Makes the query of a list that can be sorted: the common fields, and its own fields.
macro_rules! list_query {
    ($(#[$about:meta])+ $name:ident, order: $order:tt, has_names: $has_names:tt, { $($own:tt)* }) => {
        $(#[$about])+
        #[derive(Debug, Default, Deserialize, IntoParams)]
        #[serde(deny_unknown_fields)]
        #[into_params(parameter_in = Query)]
        pub struct $name {
            /// Items on the page.
            #[param(minimum = 1, maximum = 200, default = 50)]
            limit: Option<u32>,
            /// `next_cursor` of the previous page.
            cursor: Option<String>,
            /// `false` (default) for items in use, `true` for archived items, `all` for both.
            #[param(inline)]
            archived: Option<ArchivedFilter>,
            #[doc = $order]
            #[param(inline)]
            sort: Option<Sort>,
            $($own)*
        }

        impl $name {
            fn common(&self) -> Result<ListRequest, Error> {
                common(self.limit, self.cursor.as_deref(), self.archived, self.sort, $has_names)
            }
        }
    };
}

/// Query of a list that is neither filtered nor sorted: newest first.
#[derive(Debug, Default, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct NewestListQuery {
    /// Items on the page.
    #[param(minimum = 1, maximum = 200, default = 50)]
    limit: Option<u32>,
    /// `next_cursor` of the previous page.
    cursor: Option<String>,
}

impl NewestListQuery {
    /// The store's request.
    pub fn request(&self) -> Result<ListRequest, Error> {
        common(self.limit, self.cursor.as_deref(), None, None, false)
    }
}

list_query! {
    /// Query of a list of items without names.
    PlainListQuery, order: "Order: `-created_at` (default) or `created_at`.", has_names: false, {}
}

impl PlainListQuery {
    /// The store's request.
    pub fn request(&self) -> Result<ListRequest, Error> {
        self.common()
    }
}

list_query! {
    /// Query of a list of items with names.
    NamedListQuery, order: "Order: `-created_at` (default), `created_at`, `name` or `-name`.", has_names: true, {
        /// Text in the name, or for robots in the name or the serial number. Upper and lower case are the same.
        #[param(max_length = 200)]
        search: Option<String>,
    }
}

impl NamedListQuery {
    /// The store's request.
    pub fn request(self) -> Result<ListRequest, Error> {
        let common = self.common();
        let search = self.search.unwrap_or_default();
        if search.chars().count() > MAX_SEARCH || search.contains('\0') {
            return Err(invalid(format!(
                "search has at most {MAX_SEARCH} characters, none of them U+0000"
            )));
        }
        Ok(ListRequest { search, ..common? })
    }
}

list_query! {
    /// Query of a list of parameter sets.
    ParameterSetListQuery, order: "Order: `-created_at` (default) or `created_at`.", has_names: false, {
        /// Only parameter sets with this status.
        #[param(inline)]
        status: Option<ParameterSetStatus>,
    }
}

impl ParameterSetListQuery {
    /// The store's request.
    pub fn request(&self) -> Result<ListRequest, Error> {
        Ok(ListRequest {
            status: self.status.map_or("", ParameterSetStatus::as_str),
            ..self.common()?
        })
    }
}

list_query! {
    /// Query of a robot's jobs.
    JobListQuery, order: "Order: `-created_at` (default) or `created_at`.", has_names: false, {
        /// Only jobs with this status.
        #[param(inline)]
        status: Option<JobStatus>,
        /// Only jobs of this kind.
        #[param(inline)]
        kind: Option<Kind>,
    }
}

impl JobListQuery {
    /// The store's request.
    pub fn request(&self) -> Result<ListRequest, Error> {
        Ok(of_jobs(self.status, self.kind, self.common()?))
    }
}

list_query! {
    /// Query of the jobs of all robots.
    AllJobsQuery, order: "Order: `-created_at` (default) or `created_at`.", has_names: false, {
        /// Only jobs with this status.
        #[param(inline)]
        status: Option<JobStatus>,
        /// Only jobs of this kind.
        #[param(inline)]
        kind: Option<Kind>,
        /// Only jobs of this robot.
        pub robot_id: Option<String>,
    }
}

impl AllJobsQuery {
    /// The store's request, for the jobs of one robot or of all.
    pub fn request(&self) -> Result<ListRequest, Error> {
        Ok(of_jobs(self.status, self.kind, self.common()?))
    }
}

fn of_jobs(status: Option<JobStatus>, kind: Option<Kind>, common: ListRequest) -> ListRequest {
    ListRequest {
        status: status.map_or("", JobStatus::as_str),
        kind: kind.map_or("", Kind::as_str),
        ..common
    }
}
