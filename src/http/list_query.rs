//! Queries of lists: page, order and filters.

use crate::http::Error;
use crate::store::{Cursor, ListRequest};
use crate::wire::job::Kind;
use crate::wire::job_answer::JobStatus;
use crate::wire::page::{ArchivedFilter, DEFAULT_PAGE, MAX_PAGE, Sort};
use crate::wire::parameter_set::ParameterSetStatus;
use serde::Deserialize;
use utoipa::IntoParams;

/// Longest text to search for, characters: that of the longest name.
const MAX_SEARCH: usize = 200;

/// Checks the query of a list and returns the store's request. `has_names`: the items of the list have names.
fn checked(
    request: ListRequest,
    limit: Option<u32>,
    cursor: Option<&str>,
    has_names: bool,
) -> Result<ListRequest, Error> {
    let invalid_cursor = |detail| Error::bad_request("invalid_cursor", detail);
    let cursor = cursor.map(str::parse::<Cursor>).transpose();
    let cursor =
        cursor.map_err(|e| invalid_cursor(format!("{e}: pass next_cursor on as it is")))?;
    let request = ListRequest {
        limit: checked_limit(limit)?,
        cursor,
        ..request
    };
    if request.search.chars().count() > MAX_SEARCH || request.search.contains('\0') {
        return Err(Error::invalid_query(format!(
            "search has at most {MAX_SEARCH} characters, none of them U+0000"
        )));
    }
    if request.sort.is_by_name() && !has_names {
        let detail = "items of this list have no names: sort by created_at or -created_at";
        return Err(Error::invalid_query(detail));
    }
    if !request.is_consistent() {
        let detail =
            "the cursor belongs to another order of the list: start without a cursor".to_owned();
        return Err(invalid_cursor(detail));
    }
    Ok(request)
}

/// The number of items on a page.
pub fn checked_limit(limit: Option<u32>) -> Result<u32, Error> {
    match limit.unwrap_or(DEFAULT_PAGE) {
        limit @ 1..=MAX_PAGE => Ok(limit),
        limit => {
            let detail = format!("limit is {limit}; 1 to {MAX_PAGE} is allowed");
            Err(Error::invalid_query(detail))
        }
    }
}

/// Generates the query of a sortable list: the common fields and its own fields. `=> value` states what an own field contributes to the
/// field of the same name in the store's request.
macro_rules! list_query {
    ($(#[$about:meta])+ $name:ident, order: $order:tt, has_names: $has_names:tt,
     { $($(#[$meta:meta])+ $visible:vis $own:ident: $type:ty $(=> $value:expr)?,)* }) => {
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
            $($(#[$meta])+ $visible $own: $type,)*
        }

        impl $name {
            /// The store's request.
            #[allow(unused_variables)] // the pattern binds own fields that are not part of the request
            pub fn request(self) -> Result<ListRequest, Error> {
                let Self { limit, cursor, archived, sort, $($own),* } = self;
                let request = ListRequest {
                    archived: archived.unwrap_or_default(),
                    sort: sort.unwrap_or_default(),
                    $($($own: $value,)?)*
                    ..ListRequest::all()
                };
                checked(request, limit, cursor.as_deref(), $has_names)
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
        checked(
            ListRequest::all(),
            self.limit,
            self.cursor.as_deref(),
            false,
        )
    }
}

list_query! {
    /// Query of a list of items without names.
    PlainListQuery, order: "Order: `-created_at` (default) or `created_at`.", has_names: false, {}
}

list_query! {
    /// Query of a list of items with names.
    NamedListQuery, order: "Order: `-created_at` (default), `created_at`, `name` or `-name`.", has_names: true, {
        /// Text in the name, or for robots in the name or the serial number. Upper and lower case are the same.
        #[param(max_length = 200)]
        search: Option<String> => search.unwrap_or_default(),
    }
}

list_query! {
    /// Query of a list of parameter sets.
    ParameterSetListQuery, order: "Order: `-created_at` (default) or `created_at`.", has_names: false, {
        /// Only parameter sets with this status.
        #[param(inline)]
        status: Option<ParameterSetStatus> => status.map_or("", ParameterSetStatus::as_str),
    }
}

list_query! {
    /// Query of a robot's jobs.
    JobListQuery, order: "Order: `-created_at` (default) or `created_at`.", has_names: false, {
        /// Only jobs with this status.
        #[param(inline)]
        status: Option<JobStatus> => status.map_or("", JobStatus::as_str),
        /// Only jobs of this kind.
        #[param(inline)]
        kind: Option<Kind> => kind.map_or("", Kind::as_str),
    }
}

list_query! {
    /// Query of the jobs of all robots.
    AllJobsQuery, order: "Order: `-created_at` (default) or `created_at`.", has_names: false, {
        /// Only jobs with this status.
        #[param(inline)]
        status: Option<JobStatus> => status.map_or("", JobStatus::as_str),
        /// Only jobs of this kind.
        #[param(inline)]
        kind: Option<Kind> => kind.map_or("", Kind::as_str),
        /// Only jobs of this robot.
        pub robot_id: Option<String>,
    }
}

/// Generates the handler of a robot's list. An entry states the doc comment, the name, the path, the tag and operation id, the query, the
/// type of an item, and the store's function. If that function lists several kinds of documents, the entry also states the kind.
macro_rules! list_of_robot {
    ($(#[$doc:meta])+ $name:ident: $path:tt $tag:tt $operation:tt, $query:ident $item:ident, $list:path $(, $kind:expr)?) => {
        $(#[$doc])+
        #[utoipa::path(
            get, path = $path, tag = $tag, operation_id = $operation,
            params(("robot_id" = String, Path, description = "The robot"), $query),
            responses((status = 200, description = "One page", body = Page<$item>))
        )]
        pub async fn $name(
            $crate::http::extract::Item { app, caller, id }: $crate::http::extract::Item,
            $crate::http::extract::Query(query): $crate::http::extract::Query<$query>,
        ) -> Result<axum::Json<Page<$item>>, $crate::http::Error> {
            $crate::http::access::robot(&app, &caller, &id).await?;
            let found = $list(&app.store, &id, $($kind,)? &query.request()?).await?;
            Ok(axum::Json(found.into_answer()?))
        }
    };
}
pub(super) use list_of_robot;
