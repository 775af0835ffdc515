//! Instructions of the control step on the Cortex-M4F, as `cargo xtask bench` counted them on the emulated chip.

use serde::Deserialize;
use std::collections::BTreeMap;
use std::sync::OnceLock;

const COUNTS_JSON: &str = include_str!("counts.json");

#[derive(Deserialize)]
struct File {
    variants: Vec<Variant>,
}

#[derive(Deserialize)]
struct Variant {
    name: String,
    instructions: u32,
}

/// Returns the instruction counts by name, `mechanism/trigonometry/exact/terms`.
fn counts_by_name() -> &'static BTreeMap<String, u32> {
    static COUNTS: OnceLock<BTreeMap<String, u32>> = OnceLock::new();
    COUNTS.get_or_init(|| {
        let variants = serde_json::from_str::<File>(COUNTS_JSON).map(|file| file.variants).unwrap_or_default();
        variants.into_iter().map(|variant| (variant.name, variant.instructions)).collect()
    })
}

/// Returns the instructions of a complete control step at its slowest pose, or `None` if the variant was not counted.
pub fn instructions(mechanism: &str, trigonometry: &str, terms: &str) -> Option<u32> {
    counts_by_name().get(&format!("{mechanism}/{trigonometry}/exact/{terms}")).copied()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_variant_of_every_mechanism_is_counted() {
        for mechanism in haptic_bridge::model::catalogue::Kind::ALL {
            for trigonometry in ["table", "minimax", "micromath"] {
                for terms in ["none", "feed-forward", "feed-forward+z", "washout", "washout+z"] {
                    let name = mechanism.spec().label;
                    let result = instructions(name, trigonometry, terms);
                    assert!(result.is_some(), "{name}/{trigonometry}/{terms}");
                }
            }
            for (estimator, _) in haptic_bridge::render::velocity::Estimator::ALL {
                let terms = format!("feed-forward, {estimator}");
                let result = instructions(mechanism.spec().label, "table", &terms);
                assert!(result.is_some(), "{}, {estimator}", mechanism.spec().label);
            }
        }
    }
}
