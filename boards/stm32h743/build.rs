//! Puts the board's memory map where the linker looks for it.

use std::path::Path;
use std::{env, fs};

fn main() {
    let map = "memory.x";
    let out = env::var_os("OUT_DIR").expect("cargo sets OUT_DIR");
    fs::copy(map, Path::new(&out).join("memory.x")).expect("memory.x beside this file");
    println!("cargo::rustc-link-search={}", Path::new(&out).display());
    println!("cargo::rustc-link-arg-bins=-Tlink.x");
    println!("cargo::rerun-if-changed={map}");
}
