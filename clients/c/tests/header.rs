//! The header is what cbindgen makes of the source.

use std::path::Path;

const BEGIN: &str = "/* haptic-bridge boards for programs in C: libhapticbridge.
 *
 * Functions that can fail return HB_OK or another code; hb_error() then says what went wrong, in words. Every function may
 * be called from any thread; calls on one board wait for each other. SI units; vectors are in the task frame or one entry
 * a joint, with zeros in entries that the device does not have.
 *
 * Made of clients/c/src/lib.rs by cbindgen. */";

#[test]
fn the_header_is_made_of_the_source() {
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut config = cbindgen::Config {
        language: cbindgen::Language::C,
        style: cbindgen::Style::Type,
        header: Some(BEGIN.into()),
        include_guard: Some("HAPTICBRIDGE_H".into()),
        no_includes: true,
        sys_includes: vec!["stdint.h".into()],
        cpp_compat: true,
        documentation_style: cbindgen::DocumentationStyle::C,
        line_length: 120,
        ..cbindgen::Config::default()
    };
    for (rust, c) in [("Board", "hb_board"), ("Request", "hb_request"), ("State", "hb_state")] {
        config.export.rename.insert(rust.into(), c.into());
    }
    let source = here.join("src/lib.rs");
    let bindings = cbindgen::Builder::new().with_src(source).with_config(config).generate().expect("cbindgen reads it");
    let mut made = Vec::new();
    bindings.write(&mut made);
    let made = String::from_utf8(made).unwrap();
    let header = here.join("include/hapticbridge.h");
    if std::env::var_os("UPDATE_DOCS").is_some() {
        std::fs::write(&header, &made).unwrap();
    }
    let kept = std::fs::read_to_string(header).unwrap();
    assert_eq!(kept, made, "run UPDATE_DOCS=1 cargo test -p haptic-c header");
    assert_eq!(made.matches("hb_board *").count(), 11, "every function is there");
}
