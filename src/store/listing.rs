//! Filtered and sorted lists, with the total number of items.

use sqlx::any::{AnyArguments, AnyRow};
use sqlx::query::{QueryAs, QueryScalar};
use sqlx::{Any, FromRow};

use super::page::{Cursor, CursorKey};
use super::{Page, PageRequest, Result, Store};
use crate::wire::page::{ArchivedFilter, Sort};

/// Request for a page of a filtered list.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ListRequest {
    /// The page.
    pub page: PageRequest,
    /// Order of the items. A cursor that belongs to another order is ignored.
    pub sort: Sort,
    /// Whether archived items are listed.
    pub archived: ArchivedFilter,
    /// Text that the name or serial number must contain, case-insensitive; empty for all items.
    pub search: String,
    /// Status of the items; empty for any status.
    pub status: &'static str,
    /// Kind of the items; empty for any kind.
    pub kind: &'static str,
}

/// One page of a filtered list.
#[derive(Clone, Debug, PartialEq)]
pub struct Listed<T> {
    /// The page.
    pub page: Page<T>,
    /// Number of items on all pages.
    pub total: i64,
}

impl ListRequest {
    /// Every item, newest first.
    pub fn all(page: &PageRequest) -> Self {
        Self {
            page: page.clone(),
            archived: ArchivedFilter::All,
            ..Self::default()
        }
    }

    /// Whether the cursor, if there is one, belongs to the requested order.
    pub fn is_consistent(&self) -> bool {
        let cursor = self.page.cursor.as_ref();
        cursor.is_none_or(|cursor| cursor.sort == self.sort)
    }

    /// The pattern for SQL `like`: the search text between `%`, with its wildcards escaped by `!`; `%` for all items.
    pub(super) fn pattern(&self) -> String {
        let mut pattern = String::from("%");
        for c in self.search.chars() {
            if matches!(c, '%' | '_' | '!') {
                pattern.push('!');
            }
            pattern.push(c);
        }
        if !self.search.is_empty() {
            pattern.push('%');
        }
        pattern
    }
}

/// The SQL of a list. The filter uses the parameters $1 to $`n`. The cursor (key and id) and the limit are the next parameters.
pub(super) struct ListQueries {
    pub(super) newest: &'static str,
    pub(super) oldest: &'static str,
    /// Sorted by name, ascending and descending; none for lists without names.
    pub(super) by_name: Option<[&'static str; 2]>,
    pub(super) count: &'static str,
}

/// [`ListQueries`] of a table or view with `created_at_ms` and `id`. The literals are the numbers of the parameters after the filter's parameters.
macro_rules! list_queries {
    ($columns:expr, $from:expr, $filter:expr, $key:literal, $id:literal, $limit:literal) => {
        $crate::store::listing::ListQueries {
            newest: concat!(
                "select ",
                $columns,
                " from ",
                $from,
                " where ",
                $filter,
                " and (created_at_ms, id) < (",
                $key,
                ", ",
                $id,
                ")
                order by created_at_ms desc, id desc limit cast(",
                $limit,
                " as bigint)"
            ),
            oldest: concat!(
                "select ",
                $columns,
                " from ",
                $from,
                " where ",
                $filter,
                " and (created_at_ms, id) > (",
                $key,
                ", ",
                $id,
                ")
                order by created_at_ms, id limit cast(",
                $limit,
                " as bigint)"
            ),
            by_name: None,
            count: concat!("select count(*) from ", $from, " where ", $filter),
        }
    };
    ($columns:expr, $from:expr, $filter:expr, $key:literal, $id:literal, $limit:literal, $name:literal, $is_first:literal) => {
        $crate::store::listing::ListQueries {
            by_name: Some([
                concat!(
                    "select ",
                    $columns,
                    " from ",
                    $from,
                    " where ",
                    $filter,
                    " and (cast(",
                    $is_first,
                    " as bigint) = 1 or (",
                    $name,
                    ", id) > (",
                    $key,
                    ", ",
                    $id,
                    "))
                    order by ",
                    $name,
                    ", id limit cast(",
                    $limit,
                    " as bigint)"
                ),
                concat!(
                    "select ",
                    $columns,
                    " from ",
                    $from,
                    " where ",
                    $filter,
                    " and (cast(",
                    $is_first,
                    " as bigint) = 1 or (",
                    $name,
                    ", id) < (",
                    $key,
                    ", ",
                    $id,
                    "))
                    order by ",
                    $name,
                    " desc, id desc limit cast(",
                    $limit,
                    " as bigint)"
                ),
            ]),
            ..$crate::store::listing::list_queries!($columns, $from, $filter, $key, $id, $limit)
        }
    };
}
pub(super) use list_queries;

/// A row of a list.
pub(super) trait ListRow: for<'r> FromRow<'r, AnyRow> + Send + Unpin {
    fn created_at_ms(&self) -> i64;

    fn id(&self) -> &str;

    /// The name in lower case, as the database computes it; empty for lists without names.
    fn name(&self) -> &str {
        ""
    }
}

/// Implements [`ListRow`] for a row with `created_at_ms` and `id`. A second argument names the field that holds the name for sorting.
macro_rules! list_row {
    ($row:ident $(, $name:ident)?) => {
        impl $crate::store::listing::ListRow for $row {
            fn created_at_ms(&self) -> i64 {
                self.created_at_ms
            }

            fn id(&self) -> &str {
                &self.id
            }

            $(fn name(&self) -> &str {
                let sorted_by: &str = &self.$name;
                sorted_by
            })?
        }
    };
}
pub(super) use list_row;

type Rows<T> = QueryAs<'static, Any, T, AnyArguments>;

/// Reads a page. `filters` are the values of the filter's parameters.
pub(super) async fn page<T: ListRow>(
    store: &Store,
    queries: &ListQueries,
    filters: &[&str],
    request: &ListRequest,
) -> Result<Page<T>> {
    let limit = request.page.limit();
    let cursor = request.page.cursor.as_ref();
    let cursor = cursor.filter(|cursor| cursor.sort == request.sort);
    let id = cursor.map(|cursor| cursor.id.clone()).unwrap_or_default();
    let sql = match (request.sort, queries.by_name) {
        (Sort::Name, Some([by_name, _])) => by_name,
        (Sort::NameDescending, Some([_, descending])) => descending,
        (Sort::Oldest, _) => queries.oldest,
        _ => queries.newest,
    };
    let is_by_name = request.sort.is_by_name() && queries.by_name.is_some();
    let mut query: Rows<T> = sqlx::query_as(sql);
    for filter in filters {
        query = query.bind((*filter).to_owned());
    }
    let beyond = if request.sort == Sort::Oldest {
        i64::MIN
    } else {
        i64::MAX
    };
    query = match cursor.map(|cursor| &cursor.key) {
        Some(CursorKey::Name(name)) => query.bind(name.clone()),
        Some(CursorKey::CreatedAtMs(at_ms)) => query.bind(*at_ms),
        None if is_by_name => query.bind(String::new()),
        None => query.bind(beyond),
    };
    query = query.bind(id).bind(limit as i64 + 1);
    if is_by_name {
        query = query.bind(i64::from(cursor.is_none()));
    }
    let mut rows = query.fetch_all(store.readers()).await?;
    let more = rows.len() > limit;
    rows.truncate(limit);
    let next_cursor = rows.last().filter(|_| more).map(|last| Cursor {
        sort: request.sort,
        key: match is_by_name {
            true => CursorKey::Name(last.name().to_owned()),
            false => CursorKey::CreatedAtMs(last.created_at_ms()),
        },
        id: last.id().to_owned(),
    });
    Ok(Page {
        items: rows,
        next_cursor,
    })
}

/// Reads a page and counts the items of all pages.
pub(super) async fn list<T: ListRow>(
    store: &Store,
    queries: &ListQueries,
    filters: &[&str],
    request: &ListRequest,
) -> Result<Listed<T>> {
    let page = page(store, queries, filters, request).await?;
    let mut query: QueryScalar<'static, Any, i64, AnyArguments> = sqlx::query_scalar(queries.count);
    for filter in filters {
        query = query.bind((*filter).to_owned());
    }
    Ok(Listed {
        page,
        total: query.fetch_one(store.readers()).await?,
    })
}

impl ListQueries {
    /// All SQL texts of the list, for the test that prepares each one.
    pub(super) const fn texts(&self) -> [&'static str; 5] {
        let [by_name, descending] = match self.by_name {
            Some(texts) => texts,
            None => [self.newest, self.newest],
        };
        [self.newest, self.oldest, by_name, descending, self.count]
    }
}
