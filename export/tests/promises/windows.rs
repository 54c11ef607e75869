//! Materials that were fitted for a scene answer every query in every graph as the text says: led to what was fitted.

use crate::graphs::{Feed, TOLERANCE, feeds, largest_difference, run, values};
use crate::{materials, plain};
use neumip_export::onnx::{self, Options};
use neumip_export::{Checkpoint, Golden};

/// Queries a case.
const QUERIES: usize = 1024;
/// Least and largest share of queries outside of a window that tells both sides of it.
const SHARE: [f64; 2] = [0.2, 0.8];

fn plainly(checkpoint: &Checkpoint, queries: &Golden) -> Vec<f64> {
    let answer = |k: usize| {
        let (u, wi, wo, level) = (queries.u[k], queries.wi[k], queries.wo[k], queries.level[k]);
        plain::decode(checkpoint, &plain::features(checkpoint, u, wo, level), u, wi, wo, level)
    };
    (0..queries.u.len()).flat_map(answer).collect()
}

fn whole(checkpoint: &Checkpoint, queries: &Golden) -> Vec<f32> {
    run(onnx::material_graph(checkpoint, Options::default()).unwrap(), &feeds(queries))
}

fn in_steps(checkpoint: &Checkpoint, queries: &Golden) -> Vec<f32> {
    let options = Options::default();
    let of_view: Vec<Feed> = feeds(queries).into_iter().filter(|(name, ..)| *name != "wi").collect();
    let graph = onnx::prepare_graph(checkpoint, None, options).unwrap();
    let mut prepared = values(graph, &of_view, &["partial", "visible"]).into_iter();
    let (shape, partial) = prepared.next().unwrap().into_shape_vec::<f32, 2>().unwrap();
    let (_, visible) = prepared.next().unwrap().into_shape_vec::<f32, 1>().unwrap();
    let inputs = [
        ("partial", shape.to_vec(), partial),
        ("visible", vec![queries.u.len()], visible),
        ("wi", vec![queries.u.len(), 2], queries.wi.concat()),
    ];
    run(onnx::evaluate_graph(checkpoint, options).unwrap(), &inputs)
}

/// Features looked up where the text says, and what the decoder makes of them there.
fn decoded(checkpoint: &Checkpoint, queries: &Golden) -> Vec<f32> {
    let architecture = &checkpoint.header.architecture;
    let mut led = queries.clone();
    let mut features = Vec::new();
    for k in 0..queries.u.len() {
        let exact = plain::features(checkpoint, queries.u[k], queries.wo[k], queries.level[k]);
        features.extend(exact.iter().map(|f| *f as f32));
        (led.u[k], led.level[k]) = architecture.fitted(queries.u[k], queries.level[k]);
    }
    let mut inputs = vec![("features", vec![queries.u.len(), architecture.model.texture.channels], features)];
    inputs.extend(feeds(&led));
    run(onnx::decoder_graph(checkpoint, Options::default()).unwrap(), &inputs)
}

#[test]
fn graphs_of_fitted_materials_answer_inside_and_outside_as_the_text_says() {
    for (name, checkpoint) in materials::fitted() {
        let architecture = &checkpoint.header.architecture;
        let guide = architecture.guide().unwrap();
        let queries = materials::queries(architecture, QUERIES, 2);
        let outside = queries.u.iter().filter(|u| !guide.is_inside(**u)).count() as f64 / QUERIES as f64;
        assert_eq!(guide.is_window(), (SHARE[0]..SHARE[1]).contains(&outside), "{name}: {outside}");
        let expected = plainly(&checkpoint, &queries);
        let mut other = checkpoint.clone();
        materials::misplace(&mut other);
        type Way = fn(&Checkpoint, &Golden) -> Vec<f32>;
        let ways: [(&str, Way); 3] = [("material", whole), ("steps", in_steps), ("decoder", decoded)];
        for (way, answer) in ways {
            let difference = largest_difference(&answer(&checkpoint, &queries), &expected);
            println!("{name}, {way}: {difference:.1e}, {outside:.2} outside");
            assert!(difference < TOLERANCE, "{name}, {way}: {difference:e}");
            assert!(largest_difference(&answer(&other, &queries), &expected) > TOLERANCE, "{name}, {way}");
        }
    }
}
