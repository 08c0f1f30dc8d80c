//! Selection of data items by the `path` of a request, a subset of `XPath`.

use crate::device::{Category, Device};

/// Largest number of steps of one path.
const STEPS_MAX: usize = 16;

/// Error: a path is not supported.
#[derive(Debug, PartialEq, Eq)]
pub struct NotUnderstood(pub String);

/// One `//Name[@attribute="value" and ...]`.
#[derive(Debug)]
struct Step<'a> {
    /// Element name; `*` matches every element.
    name: &'a str,
    conditions: Vec<(&'a str, &'a str)>,
}

/// Returns for each data item whether the path selects it. Paths are joined by `|`; a path selects the data items that
/// it names, and those within a component that it names.
///
/// # Errors
/// Fails if it is not a path, or if it contains more than elements by name and attributes by value.
pub fn wanted(device: &Device, path: &str) -> Result<Vec<bool>, NotUnderstood> {
    let mut wanted = vec![false; device.items.len()];
    for one in path.split('|') {
        let steps = steps(one.trim())?;
        for (index, is_wanted) in wanted.iter_mut().enumerate() {
            *is_wanted |= fits(device, index, &steps);
        }
    }
    Ok(wanted)
}

fn steps(path: &str) -> Result<Vec<Step<'_>>, NotUnderstood> {
    let not_understood = || {
        NotUnderstood(format!(
            "\"{path:.200}\": write //Name[@attribute=\"value\"] for each level"
        ))
    };
    let mut rest = path;
    let mut steps = Vec::new();
    while !rest.is_empty() {
        rest = rest
            .strip_prefix("//")
            .or_else(|| rest.strip_prefix('/'))
            .ok_or_else(not_understood)?;
        let end = rest.find(['/', '[']).unwrap_or(rest.len());
        let (name, behind) = rest.split_at(end);
        if name.is_empty() || steps.len() == STEPS_MAX {
            return Err(not_understood());
        }
        rest = behind;
        let mut conditions = Vec::new();
        if let Some(inside) = rest.strip_prefix('[') {
            let (inside, behind) = inside.split_once(']').ok_or_else(not_understood)?;
            for condition in inside.split(" and ") {
                let (key, value) = condition.split_once('=').ok_or_else(not_understood)?;
                let key = key.trim().strip_prefix('@').ok_or_else(not_understood)?;
                let value = value.trim();
                let quoted = value.strip_prefix('"').and_then(|value| value.strip_suffix('"'));
                let quoted = quoted.or_else(|| value.strip_prefix('\'')?.strip_suffix('\''));
                conditions.push((key, quoted.ok_or_else(not_understood)?));
            }
            rest = behind;
        }
        steps.push(Step { name, conditions });
    }
    if steps.is_empty() {
        return Err(not_understood());
    }
    Ok(steps)
}

/// Returns true if the elements from the device to a data item match the steps in their order.
fn fits(device: &Device, item: usize, steps: &[Step<'_>]) -> bool {
    let this = &device.items[item];
    let mut components = vec![this.component];
    while let Some(parent) = components
        .last()
        .and_then(|index| device.components[*index].parent)
    {
        components.push(parent);
    }
    let mut left = steps.iter().peekable();
    for index in components.into_iter().rev() {
        let component = &device.components[index];
        let value = |key: &str| match key {
            "id" => Some(component.id.as_str()),
            "name" => Some(component.name.as_str()),
            "uuid" if component.parent.is_none() => Some(device.uuid.as_str()),
            _ => None,
        };
        let is_named = |name: &str| {
            matches!(name, "*" | "Devices" | "Components" | "MTConnectDevices") || name == component.element
        };
        while left
            .next_if(|step| ["MTConnectDevices", "Devices", "Components"].contains(&step.name))
            .is_some()
        {}
        left.next_if(|step| is_named(step.name) && step.fits(&value));
    }
    let value = |key: &str| match key {
        "id" => Some(this.id.as_str()),
        "type" => Some(this.kind),
        "subType" => this.sub_type,
        "category" => Some(Category::name(this.category)),
        _ => None,
    };
    while left
        .next_if(|step| step.name == "DataItems" || step.name == "Components")
        .is_some()
    {}
    left.next_if(|step| matches!(step.name, "DataItem" | "*") && step.fits(&value));
    left.peek().is_none()
}

impl Step<'_> {
    fn fits<'v>(&self, value: &dyn Fn(&str) -> Option<&'v str>) -> bool {
        self.conditions
            .iter()
            .all(|(key, wanted)| value(key) == Some(*wanted))
    }
}
