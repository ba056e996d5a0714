//! Filtered and sorted lists, with the total number of items.

use sqlx::any::{AnyArguments, AnyRow};
use sqlx::query::{QueryAs, QueryScalar};
use sqlx::{Any, AssertSqlSafe, FromRow};

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

/// A list: what of a table or view with `created_at_ms` and `id` it has.
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
    let is_by_name = request.sort.is_by_name() && queries.name.is_some();
    let mut query: Rows<T> = sqlx::query_as(AssertSqlSafe(queries.page(request.sort)));
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
    let mut query: QueryScalar<'static, Any, i64, AnyArguments> =
        sqlx::query_scalar(AssertSqlSafe(queries.count()));
    for filter in filters {
        query = query.bind((*filter).to_owned());
    }
    Ok(Listed {
        page,
        total: query.fetch_one(store.readers()).await?,
    })
}
