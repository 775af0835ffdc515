//! Checks the metadata of the published packages, and publishes them in a dry run.

use anyhow::Result;

use crate::images;
use crate::paths::root;
use crate::toolchain::{cargo, run};

/// Packs all packages, including the tool's images, and builds each from its packed sources. Uploads nothing.
pub fn dry_run() -> Result<()> {
    images::build_all()?;
    run(cargo().current_dir(root()).args(["publish", "--workspace", "--dry-run", "--locked", "--allow-dirty"]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::library::CRATES;
    use serde_json::Value;
    use std::collections::BTreeMap;

    fn packages() -> BTreeMap<String, Value> {
        let mut command = cargo();
        command.current_dir(root()).args(["metadata", "--no-deps", "--offline", "--format-version", "1"]);
        let metadata: Value = serde_json::from_slice(&command.output().unwrap().stdout).unwrap();
        let packages = metadata["packages"].as_array().unwrap().iter();
        packages.map(|package| (package["name"].as_str().unwrap().to_string(), package.clone())).collect()
    }

    #[test]
    fn the_library_its_crates_and_the_tool_are_published() {
        let published = |package: &Value| package["publish"].as_array().is_none_or(|registries| !registries.is_empty());
        let mut found: Vec<String> =
            packages().into_iter().filter(|(_, package)| published(package)).map(|(name, _)| name).collect();
        let mut wanted: Vec<&str> = [&CRATES[..], &["haptic", "haptic-bridge", "haptic-fpu"]].concat();
        found.sort();
        wanted.sort_unstable();
        assert_eq!(found, wanted);
    }

    #[test]
    fn published_packages_have_metadata_and_versions_of_each_other() {
        let all = packages();
        let version = &all["haptic"]["version"];
        let mut checked = 0;
        for (name, package) in &all {
            assert_eq!(&package["version"], version, "{name}");
            if package["publish"].as_array().is_some_and(Vec::is_empty) {
                continue;
            }
            for key in ["description", "license", "repository", "rust_version"] {
                assert!(package[key].as_str().is_some_and(|text| !text.is_empty()), "{name} has no {key}");
            }
            let keywords = package["keywords"].as_array().unwrap().len();
            assert!((1..=5).contains(&keywords), "{name}: a registry accepts one to five keywords");
            assert!(!package["categories"].as_array().unwrap().is_empty(), "{name} has no categories");
            let metadata = &package["metadata"];
            match name.as_str() {
                "haptic" => assert!(metadata["binstall"]["pkg-url"].as_str().unwrap().ends_with(".tar.gz")),
                _ => assert!(metadata["docs"]["rs"].is_object(), "{name} has no metadata for docs.rs"),
            }
            for needed in package["dependencies"].as_array().unwrap().iter().filter(|needed| needed["path"].is_string())
            {
                checked += 1;
                let wanted = format!("^{}", version.as_str().unwrap());
                assert_eq!(needed["req"], wanted, "{name} needs {}", needed["name"]);
                let published = all[needed["name"].as_str().unwrap()]["publish"].is_null();
                assert!(
                    published || needed["kind"] == "dev",
                    "{name} needs {}, which is not published",
                    needed["name"]
                );
            }
        }
        assert!(checked > 20, "{checked}");
    }
}
