//! Filtered and sorted lists, with the total number of items.

use sqlx::AssertSqlSafe;

use super::page::{Cursor, CursorKey};
use super::sql::Row;
use super::{Page, Result, Store};
use crate::wire::page::{ArchivedFilter, MAX_PAGE, Sort};

/// Request for a page of a list.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ListRequest {
    /// Maximum number of items on the page; clamped to 1..=[`MAX_PAGE`].
    pub limit: u32,
    /// End of the previous page; none for the first page.
    pub cursor: Option<Cursor>,
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

impl ListRequest {
    /// Every item, newest first.
    pub fn all() -> Self {
        Self {
            limit: MAX_PAGE,
            cursor: None,
            sort: Sort::default(),
            archived: ArchivedFilter::All,
            search: String::new(),
            status: "",
            kind: "",
        }
    }

    /// Whether the cursor, if there is one, belongs to the requested order.
    pub fn is_consistent(&self) -> bool {
        let cursor = self.cursor.as_ref();
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

/// The parts of a list's SQL. The list reads a table or view with the columns `created_at_ms` and `id`.
pub(super) struct ListQueries {
    pub(super) columns: &'static str,
    pub(super) from: &'static str,
    /// The condition, with the parameters $1 to $`n_filters`. The cursor (key and id) and the limit are the next parameters.
    pub(super) filter: &'static str,
    pub(super) n_filters: usize,
    /// The name in lower case, for lists that are sorted by name, too.
    pub(super) name: Option<&'static str>,
}

impl ListQueries {
    /// The SQL of a page.
    fn page(&self, sort: Sort) -> String {
        let Self {
            columns,
            from,
            filter,
            n_filters: n,
            name,
        } = self;
        let (key, id, limit, is_first) = (n + 1, n + 2, n + 3, n + 4);
        let (sorted_by, place, direction) = match (sort, name) {
            (Sort::Name, Some(name)) => (*name, ">", ""),
            (Sort::NameDescending, Some(name)) => (*name, "<", " desc"),
            (Sort::Oldest, _) => ("created_at_ms", ">", ""),
            _ => ("created_at_ms", "<", " desc"),
        };
        let mut beyond = format!("({sorted_by}, id) {place} (${key}, ${id})");
        if sort.is_by_name() && name.is_some() {
            beyond = format!("(cast(${is_first} as bigint) = 1 or {beyond})");
        }
        format!(
            "select {columns} from {from} where {filter} and {beyond}
             order by {sorted_by}{direction}, id{direction} limit cast(${limit} as bigint)"
        )
    }

    /// The SQL that counts the items of all pages.
    fn count(&self) -> String {
        format!("select count(*) from {} where {}", self.from, self.filter)
    }

    /// All SQL texts of the list, for the test that prepares each one.
    pub(super) fn texts(&self) -> impl Iterator<Item = String> {
        let sorts = [Sort::Newest, Sort::Oldest, Sort::Name, Sort::NameDescending];
        let pages = sorts.into_iter().map(|sort| self.page(sort));
        pages.chain([self.count()])
    }
}

/// A row of a list.
pub(super) trait ListRow: Row {
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

/// Reads a page, and counts the items of all pages. `filters` are the values of the filter's parameters.
pub(super) async fn list<T: ListRow>(
    store: &Store,
    queries: &ListQueries,
    filters: &[&str],
    request: &ListRequest,
) -> Result<Page<T>> {
    let limit = request.limit.clamp(1, MAX_PAGE) as usize;
    let cursor = request.cursor.as_ref();
    let cursor = cursor.filter(|cursor| cursor.sort == request.sort);
    let id = cursor.map_or("", |cursor| &cursor.id);
    let is_by_name = request.sort.is_by_name() && queries.name.is_some();
    let mut query = sqlx::query_as(AssertSqlSafe(queries.page(request.sort)));
    let mut count = sqlx::query_scalar(AssertSqlSafe(queries.count()));
    for filter in filters {
        query = query.bind(*filter);
        count = count.bind(*filter);
    }
    query = match cursor.map(|cursor| &cursor.key) {
        Some(CursorKey::Name(name)) => query.bind(name),
        Some(CursorKey::CreatedAtMs(at_ms)) => query.bind(at_ms),
        None if is_by_name => query.bind(""),
        None if request.sort == Sort::Oldest => query.bind(i64::MIN),
        None => query.bind(i64::MAX),
    };
    query = query.bind(id).bind(limit as i64 + 1);
    if is_by_name {
        query = query.bind(i64::from(cursor.is_none()));
    }
    let mut rows: Vec<T> = query.fetch_all(store.readers()).await?;
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
        total: count.fetch_one(store.readers()).await?,
    })
}
