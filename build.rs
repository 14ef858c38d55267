//! Generates Rust types of the MAVLink messages in `src/mavlink/dialect.xml`.

fn main() {
    println!("cargo:rerun-if-changed=build.rs");
    #[cfg(feature = "mavlink")]
    mavlink::generate();
}

#[cfg(feature = "mavlink")]
mod mavlink {
    use mavlink_bindgen::XmlDefinitions;
    use std::path::Path;
    use std::{env, fs};

    /// Relative to the package, where build scripts run.
    const DEFINITIONS: &str = "src/mavlink/dialect.xml";

    /// Attributes that the generated module needs: names are MAVLink's, and the generator asks for features of the
    /// crate `mavlink`, which this package does not have.
    const MODULE: &str =
        "#[allow(missing_docs, non_camel_case_types, non_snake_case, unexpected_cfgs, clippy::all)]
pub mod dialect;
";

    /// Writes `dialect.rs` and `mod.rs`, which declares it, into `OUT_DIR`.
    pub fn generate() {
        let out = env::var_os("OUT_DIR").expect("OUT_DIR is set for build scripts");
        let definitions = XmlDefinitions::Files(vec![DEFINITIONS]);
        let bindings = mavlink_bindgen::generate(definitions, &out)
            .unwrap_or_else(|error| panic!("{DEFINITIONS}: {error}"));
        // Features of the crate `mavlink` that the generated code tests; this package has none of them.
        println!(r#"cargo:rustc-check-cfg=cfg(feature, values("arbitrary", "serde", "ts-rs"))"#);
        mavlink_bindgen::emit_cargo_build_messages(&bindings);
        fs::write(Path::new(&out).join("mod.rs"), MODULE).expect("OUT_DIR can be written");
    }
}
