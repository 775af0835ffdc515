//! The page of `haptic report` is complete and shows the output of the command lines that it lists.

use crate::common::{Folder, output};

fn unescape(text: &str) -> String {
    text.replace("&lt;", "<").replace("&gt;", ">").replace("&quot;", "\"").replace("&amp;", "&")
}

/// Returns the names of all elements of a page. Checks that each element is closed.
fn closed_elements(page: &str) -> Vec<String> {
    let (mut open, mut all): (Vec<String>, Vec<String>) = (Vec::new(), Vec::new());
    for tag in page.split('<').skip(1) {
        let tag = tag.split_once('>').unwrap_or_else(|| panic!("no end: {}", &tag[..40.min(tag.len())])).0;
        let name: String = tag.trim_start_matches('/').chars().take_while(char::is_ascii_alphanumeric).collect();
        if tag.starts_with('!') {
            continue;
        }
        if tag.starts_with('/') {
            assert_eq!(open.pop(), Some(name));
        } else {
            all.push(name.clone());
            if !tag.ends_with('/') {
                open.push(name);
            }
        }
    }
    assert!(open.is_empty(), "{open:?}");
    all
}

#[test]
fn the_page_is_complete_and_shows_the_output_of_its_commands() {
    let folder = Folder::new();
    let path = folder.path("page.html");
    let (device, scene) = ("devices/haply-2diy.toml", "devices/scenes/haply-2diy/wall-stiff.toml");
    output(&["report", device, scene, "--without", "tune", "--out", &path]);
    let page = std::fs::read_to_string(path).unwrap();
    let elements = closed_elements(&page);
    for name in ["script", "link", "img", "iframe", "object"] {
        assert!(!elements.contains(&name.to_string()), "{name}");
    }
    for word in ["http:", "https:", "src=", "href=\"h", "@import", "url(h"] {
        assert!(!page.contains(word), "{word}");
    }
    // Pictures of check, map, range, why and design.
    assert_eq!(elements.iter().filter(|name| *name == "svg").count(), 5);
    // Identifiers are unique.
    let mut names: Vec<&str> = page.split("id=\"").skip(1).map(|rest| rest.split('"').next().unwrap()).collect();
    let many = names.len();
    names.sort_unstable();
    names.dedup();
    assert_eq!(names.len(), many);

    // Every answer of the first page links to a section that exists.
    let links: Vec<&str> = page.split("href=\"#").skip(1).map(|rest| rest.split('"').next().unwrap()).collect();
    assert!(links.len() >= 5 && links.iter().all(|link| names.contains(link)), "{links:?} {names:?}");
    for answer in ["At home the motors make", "which takes", "the stable area", "A tenth "] {
        assert!(page.contains(answer), "{answer}");
    }

    let lines: Vec<String> =
        page.split("<code>").skip(1).map(|rest| unescape(rest.split("</code>").next().unwrap())).collect();
    assert_eq!(lines.len(), 5);
    let mut pages = page.split("<section ").skip(1);
    for line in lines {
        let section = unescape(pages.next().unwrap());
        let words: Vec<&str> = line.split(' ').skip(1).collect();
        let words = match words.iter().position(|word| *word == "--svg") {
            Some(at) => &words[..at],
            None => &words[..],
        };
        let printed = output(words);
        assert!(printed.len() > 100 && section.contains(printed.trim_end()), "{line}\n{printed}");
    }
}
