//! The library of robot models. The data are in `data/robot-models`, one file per manufacturer, and are compiled into the binary.

use crate::wire::robot_model::{RobotModel, RobotModelPage, RobotModelSummary};
use std::sync::LazyLock;

/// The files, one per manufacturer.
const FILES: [&str; 14] = [
    include_str!("../../data/robot-models/abb.json"),
    include_str!("../../data/robot-models/denso.json"),
    include_str!("../../data/robot-models/doosan.json"),
    include_str!("../../data/robot-models/epson.json"),
    include_str!("../../data/robot-models/fanuc.json"),
    include_str!("../../data/robot-models/franka.json"),
    include_str!("../../data/robot-models/kawasaki.json"),
    include_str!("../../data/robot-models/kinova.json"),
    include_str!("../../data/robot-models/kuka.json"),
    include_str!("../../data/robot-models/mitsubishi.json"),
    include_str!("../../data/robot-models/staubli.json"),
    include_str!("../../data/robot-models/ufactory.json"),
    include_str!("../../data/robot-models/ur.json"),
    include_str!("../../data/robot-models/yaskawa.json"),
];

/// Maximum length of a search text, characters. The longest name of a model has 30.
pub const MAX_SEARCH_CHARS: usize = 100;

static ALL: LazyLock<Result<Vec<RobotModel>, String>> = LazyLock::new(|| {
    let mut all = Vec::new();
    for file in FILES {
        let mut models: Vec<RobotModel> =
            serde_json::from_str(file).map_err(|error| error.to_string())?;
        for model in &mut models {
            model.robot.description = Some(description(model));
        }
        all.append(&mut models);
    }
    Ok(all)
});

/// The description of a robot that is created from an entry. It states where the data come from.
fn description(model: &RobotModel) -> String {
    let sources: Vec<&str> = model.sources.iter().map(|s| s.title.as_str()).collect();
    format!(
        "Nominal arm {} of the library. Base: {}. Flange: {}. Sources: {}.",
        model.id,
        model.base,
        model.flange,
        sources.join("; ")
    )
}

/// All robot models, sorted by manufacturer and name.
///
/// # Errors
/// If a file cannot be parsed. A test parses all files.
pub fn all() -> Result<&'static [RobotModel], &'static str> {
    ALL.as_deref().map_err(String::as_str)
}

/// The robot model with this id.
pub fn get(id: &str) -> Result<Option<&'static RobotModel>, &'static str> {
    Ok(all()?.iter().find(|model| model.id == id))
}

/// The robot models of a manufacturer whose names contain every word of a text. Letter case, spaces and punctuation are ignored: `m10ia` finds the
/// M-10iA.
pub fn find(text: &str, maker: Option<&str>) -> Result<Vec<&'static RobotModel>, &'static str> {
    let words: Vec<String> = text.split_whitespace().map(letters).collect();
    let maker = maker.map(letters);
    let has = |model: &&RobotModel| {
        let name = names(model);
        words.iter().all(|word| name.contains(word))
            && maker
                .as_ref()
                .is_none_or(|maker| letters(&makers(model)).contains(maker))
    };
    Ok(all()?.iter().filter(has).collect())
}

/// The robot models with this id or name. Letter case, spaces and punctuation are ignored, and the manufacturer may precede the name. A
/// name that is only part of another name is a different arm.
pub fn called(text: &str) -> Result<Vec<&'static RobotModel>, &'static str> {
    let text = letters(text);
    let is_called = |model: &&RobotModel| {
        let RobotModel {
            id, name, maker, ..
        } = model;
        let names = [id, name, &model.robot.name, &format!("{maker} {name}")];
        names.iter().any(|name| letters(name) == text)
    };
    Ok(all()?.iter().filter(is_called).collect())
}

/// The page of robot models after the model with the id `after`.
///
/// # Errors
/// As [`all`]. The result is `Ok(None)` if no model has the id `after`.
pub fn page(
    text: &str,
    maker: Option<&str>,
    limit: usize,
    after: Option<&str>,
) -> Result<Option<RobotModelPage>, &'static str> {
    let found = find(text, maker)?;
    let start = match after {
        None => 0,
        Some(id) => match found.iter().position(|model| model.id == id) {
            Some(at) => at + 1,
            None => return Ok(None),
        },
    };
    let end = found.len().min(start + limit);
    let last = found[start..end].last();
    Ok(Some(RobotModelPage {
        items: found[start..end]
            .iter()
            .map(|model| RobotModelSummary::from(*model))
            .collect(),
        next_cursor: last
            .filter(|_| end < found.len())
            .map(|model| model.id.clone()),
        total: found.len(),
    }))
}

fn makers(model: &RobotModel) -> String {
    format!("{} {}", model.maker, model.also.join(" "))
}

/// All names of a model, its manufacturer and its id, without spaces and punctuation. The parts are separated by a character that no search text
/// contains.
fn names(model: &RobotModel) -> String {
    let parts = [&model.robot.name, &model.name, &makers(model), &model.id];
    parts.map(|part| letters(part)).join("\n")
}

fn letters(text: &str) -> String {
    text.chars()
        .filter(|c| c.is_alphanumeric())
        .flat_map(char::to_lowercase)
        .collect()
}
