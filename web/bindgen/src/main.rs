//! `bindgen PAGE.wasm FOLDER`: the tool `wasm-bindgen --target web`, of the version that the page is locked to.

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let [input, folder] = &args[..] else { return Err("PAGE.wasm and a folder were expected".into()) };
    wasm_bindgen_cli_support::Bindgen::new().input_path(input).web(true)?.typescript(false).generate(folder)?;
    Ok(())
}
