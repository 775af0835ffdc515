//! Builds the page of `haptic view` as one file, which contains clients/page/ compiled to WebAssembly.

use std::fs;
use std::path::PathBuf;

use anyhow::{Context as _, Result, ensure};

use crate::paths::{root, target_directory};
use crate::toolchain::{BROWSERS, cargo_for, run};
use crate::tools::{self, Tool};

/// Content security policy of the file, which may run its own contents, including worker and library, but not use the
/// network.
const POLICY: &str = "default-src 'none'; script-src 'unsafe-inline' 'wasm-unsafe-eval'; worker-src blob:; \
                      style-src 'unsafe-inline'; img-src data:; base-uri 'none'; form-action 'none'";

const PAGE: &str = "crates/show/src/view/page";

pub fn build() -> Result<PathBuf> {
    tools::check(&[Tool::Browsers])?;
    let mut command = cargo_for("rustc", BROWSERS);
    command.current_dir(root()).arg("--target-dir").arg(target_directory());
    run(command.args(["--locked", "--package", "haptic-page", "--profile", "playground"]))?;
    let library = target_directory().join(BROWSERS).join("playground/haptic_page.wasm");
    let library = fs::read(&library).with_context(|| format!("cannot read {}", library.display()))?;
    let page = assemble(&page()?, &read("clients/page/src/page.js")?, &read("clients/page/src/worker.js")?, &library)?;
    let directory = target_directory().join("playground");
    fs::create_dir_all(&directory).with_context(|| format!("cannot make {}", directory.display()))?;
    let path = directory.join("haptic-page.html");
    fs::write(&path, &page).with_context(|| format!("cannot write {}", path.display()))?;
    println!("{}: {:.1} MB; open it in a browser", path.display(), 1e-6 * page.len() as f64);
    Ok(path)
}

fn read(path: &str) -> Result<String> {
    fs::read_to_string(root().join(path)).with_context(|| format!("cannot read {path}"))
}

/// Assembles the page as the tool serves it, with its styles and scripts.
fn page() -> Result<String> {
    let named = read(&format!("{PAGE}/page.html"))?;
    let mut page = named.clone();
    for name in named.lines().filter_map(|line| line.strip_prefix("/* ")?.strip_suffix(" */")) {
        page = replace_mark(&page, &format!("/* {name} */\n"), &read(&format!("{PAGE}/{name}"))?)?;
    }
    Ok(page)
}

fn assemble(page: &str, script: &str, worker: &str, library: &[u8]) -> Result<String> {
    let inside = format!(
        "<script type=\"text/plain\" id=\"worker\">{worker}</script>\n<script type=\"text/plain\" id=\"library\">{}</script>\n\
         <script>{script}</script>",
        base64(library)
    );
    let charset = "<meta charset=\"utf-8\">";
    let policy = format!("{charset}\n<meta http-equiv=\"Content-Security-Policy\" content=\"{POLICY}\">");
    replace_mark(&replace_mark(page, charset, &policy)?, "<!-- playground -->", &inside)
}

fn replace_mark(page: &str, mark: &str, text: &str) -> Result<String> {
    ensure!(page.matches(mark).count() == 1, "{PAGE}/page.html must contain {mark} once");
    Ok(page.replacen(mark, text, 1))
}

fn base64(bytes: &[u8]) -> String {
    const DIGITS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut text = String::with_capacity(bytes.len().div_ceil(3) * 4);
    for three in bytes.chunks(3) {
        let number = three.iter().enumerate().fold(0, |number, (i, byte)| number | u32::from(*byte) << (16 - 8 * i));
        for digit in 0..4 {
            let six = (number >> (18 - 6 * digit)) as usize % 64;
            text.push(if digit > three.len() { '=' } else { char::from(DIGITS[six]) });
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The examples are those of RFC 4648, section 10.
    #[test]
    fn base64_agrees_with_its_standard() {
        for (bytes, text) in [("", ""), ("f", "Zg=="), ("fo", "Zm8="), ("foo", "Zm9v"), ("foobar", "Zm9vYmFy")] {
            assert_eq!(base64(bytes.as_bytes()), text);
        }
        assert_eq!(base64(&[0xfb, 0xff, 0xfe]), "+//+");
    }

    #[test]
    fn the_page_has_all_marks_and_no_script_ends_early() {
        let [script, worker] =
            ["clients/page/src/page.js", "clients/page/src/worker.js"].map(|path| read(path).unwrap());
        let page = page().unwrap();
        assert!(!script.contains("</script") && !worker.contains("</script"));
        let assembled = assemble(&page, &script, &worker, b"foobar").unwrap();
        assert!(assembled.contains("id=\"library\">Zm9vYmFy</script>") && assembled.contains("wasm-unsafe-eval"));
        assert!(assemble("", "", "", b"").is_err());
    }
}
