//! scratch
use neumip_export::shader::*;
fn main() {
    let a: Vec<String> = std::env::args().collect();
    let c = neumip_export::Checkpoint::read(std::path::Path::new(&a[1])).unwrap();
    std::fs::create_dir_all(&a[2]).unwrap();
    let out = std::path::Path::new(&a[2]);
    let s = a.get(3).map(|p| neumip_export::Sampler::read(std::path::Path::new(p)).unwrap());
    for (name, text) in files(&c, s.as_ref()).unwrap() {
        std::fs::write(out.join(name), text).unwrap();
    }
    let layout =
        neumip_export::weights::Layout::new(&c.header.architecture, s.as_ref().map(|s| &s.header.config));
    let block = layout.fill(&c, s.as_ref()).unwrap();
    std::fs::write(out.join("weights-f32.bin"), neumip_export::weights::single_bytes(&block)).unwrap();
}
