use super::*;

/// Most segments of a cloth: what the tree over them may cost in memory and time.
const MOST_SEGMENTS: usize = 600_000;
/// Fewest: below, a yarn is a tube.
const FEWEST_SEGMENTS: usize = 200_000;
/// Radius of a fibre in texels of a tile of 256: fine enough for a yarn to have several, coarse enough to be seen.
const RADIUS_IN_TEXELS: Range<f64> = 0.3..1.0;
/// Thickness of a cloth, base to highest hair, in tile widths: parallax to be learned, within reach of one offset.
const THICKNESS: Range<f64> = 0.02..0.15;
/// A coordinate below 2 plus a whole tile rounds once, at 2.2e-16 of 2.
const ROUNDING: f64 = 1e-15;
/// Least distance of warp and weft where they cross, as a share of that at which they touch. Points up to 0.3 pitches
/// from the crossing count, where a passage has begun; less than half would be yarns that run through each other.
const LEAST_GAP: f64 = 0.5;

fn sub(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    yarn::add(a, b, -1.0)
}

/// The whole tile by which the curve's end lies behind its start, if it does.
fn tile_vector(curve: &Curve) -> Option<[f64; 3]> {
    let way = sub(*curve.points.last()?, curve.points[0]);
    let whole = way.map(f64::round);
    let off = sub(way, whole).iter().fold(0.0, |most: f64, c| most.max(c.abs()));
    let one_tile = whole == [1.0, 0.0, 0.0] || whole == [0.0, 1.0, 0.0];
    (one_tile && off <= ROUNDING).then_some(whole)
}

/// Cosine of the bend between two directions.
fn bend(a: [f64; 3], b: [f64; 3]) -> f64 {
    let (a, b) = (yarn::unit(a), yarn::unit(b));
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// True if the curve bends no more at its seam than away from it.
fn smooth_at_seam(curve: &Curve) -> bool {
    let ways: Vec<_> = curve.points.windows(2).map(|w| sub(w[1], w[0])).collect();
    let inner = &ways[1..ways.len() - 1];
    let sharpest = inner.windows(2).map(|w| bend(w[0], w[1])).fold(1.0, f64::min);
    bend(ways[ways.len() - 1], ways[0]) >= sharpest.min(0.99)
}

/// Mean height of warp minus that of weft at each crossing, row j, column i.
fn gaps_of(cloth: &Cloth, weave: &Weave) -> Vec<f64> {
    let (warps, wefts) = (weave.warps(), weave.wefts());
    let mut sums = vec![[[0.0; 2]; 2]; warps * wefts];
    for curve in &cloth.curves[..cloth.endless] {
        let family = usize::from(tile_vector(curve) == Some([1.0, 0.0, 0.0]));
        for [x, y, z] in &curve.points[1..] {
            let (x, y) = (x.rem_euclid(1.0) * warps as f64, y.rem_euclid(1.0) * wefts as f64);
            if (x.fract() - 0.5).abs() < 0.3 && (y.fract() - 0.5).abs() < 0.3 {
                let sum = &mut sums[(y as usize % wefts) * warps + x as usize % warps][family];
                *sum = [sum[0] + z, sum[1] + 1.0];
            }
        }
    }
    sums.iter().map(|[warp, weft]| warp[0] / warp[1] - weft[0] / weft[1]).collect()
}

#[test]
fn every_name_makes_a_cloth_within_bounds() {
    for (name, seed) in NAMES.into_iter().zip([0, 1, u64::MAX]) {
        let cloth = make(name, seed).unwrap();
        let segments = cloth.segments();
        assert!((FEWEST_SEGMENTS..=MOST_SEGMENTS).contains(&segments), "{name}: {segments}");
        let [low, high] = cloth.height_range();
        assert!(THICKNESS.contains(&(high - low)), "{name}: {low} to {high}");
        assert!(cloth.curves.iter().all(|c| c.points.iter().all(|p| p[2] - c.radius > cloth.base_height)));
        assert!(cloth.curves.iter().all(|c| c.points.iter().flatten().all(|v| v.is_finite())));
        assert!(cloth.curves.iter().all(|c| (c.look as usize) < cloth.looks.len()));
        assert!(cloth.curves[..cloth.endless].iter().all(|c| RADIUS_IN_TEXELS.contains(&(256.0 * c.radius))));
        for look in &cloth.looks {
            let bsdf = crate::reference::fibre_shading::FibreBsdf::new(look);
            assert!(bsdf.is_ok(), "{name}: {look:?}");
        }
    }
    let error = make("hessian", 0).unwrap_err().to_string();
    assert!(error.contains("hessian") && error.contains("basket-cloth, twill, victorian-fabric"), "{error}");
}

fn seed_is_a_cloth(name: &str) {
    let cloth = make(name, 3).unwrap();
    assert_eq!(cloth.curves, make(name, 3).unwrap().curves);
    let other = make(name, 4).unwrap();
    assert_ne!(cloth.curves, other.curves);
    assert_ne!(cloth.looks, other.looks);
}

#[test]
fn a_seed_is_a_basket_cloth() {
    seed_is_a_cloth("basket-cloth");
}

#[test]
fn a_seed_is_a_twill() {
    seed_is_a_cloth("twill");
}

#[test]
fn a_seed_is_a_victorian_fabric() {
    seed_is_a_cloth("victorian-fabric");
}

#[test]
fn every_fibre_goes_on_in_the_next_tile() {
    for name in NAMES {
        let mut cloth = make(name, 5).unwrap();
        for (k, curve) in cloth.curves.iter().enumerate() {
            assert_eq!(tile_vector(curve).is_some(), k < cloth.endless, "{name}: curve {k}");
        }
        assert!(cloth.curves[..cloth.endless].iter().all(smooth_at_seam), "{name}");

        let curve = &mut cloth.curves[0];
        let last = curve.points.len() - 1;
        curve.points[last][2] += 1e-9;
        assert_eq!(tile_vector(curve), None);
        curve.points[0][0] += 6.0 * curve.radius;
        assert!(!smooth_at_seam(curve), "{name}");
    }
}

#[test]
fn warp_is_above_weft_where_the_weave_says_so() {
    for name in NAMES {
        let design = design(name, 1).unwrap();
        let cloth = design.weave_it(name, 1);
        let weave = &design.weave;
        let touching = design.touching();
        let gaps = gaps_of(&cloth, weave);
        for (k, gap) in gaps.iter().enumerate() {
            let (i, j) = (k % weave.warps(), k / weave.warps());
            assert_eq!(*gap > 0.0, weave.warp_on_top(i, j), "{name}: warp {i}, weft {j}");
            assert!(gap.abs() > LEAST_GAP * touching, "{name}: warp {i}, weft {j}: {gap} of {touching}");
        }
        let off_by_one = |k: usize| weave.warp_on_top(k % weave.warps() + 1, k / weave.warps());
        assert!(gaps.iter().enumerate().any(|(k, gap)| (*gap > 0.0) != off_by_one(k)));
        let flatten =
            |(lay, spin): &(Lay, Spin)| (Lay { crimp: 0.3 * lay.crimp, ..lay.clone() }, spin.clone());
        let (warp, weft) = (flatten(&design.warp), flatten(&design.weft));
        let flat = Design { warp, weft, ..design };
        let gaps = gaps_of(&flat.weave_it(name, 1), &flat.weave);
        assert!(gaps.iter().any(|gap| gap.abs() < LEAST_GAP * touching));
    }
}

#[test]
fn shades_go_from_dark_to_light_and_stay_in_range() {
    let look = FibreLook {
        colour: [0.9, 0.5, 0.0],
        longitudinal_roughness: 0.3,
        azimuthal_roughness: 0.3,
        ior: 1.5,
        tilt: 0.0,
    };
    let mut looks = vec![look];
    assert_eq!(add_shades(&mut looks, look, 4, 0.5), 1..5);
    assert!(looks[1..].windows(2).all(|w| w[0].colour[1] < w[1].colour[1]));
    assert!(looks.iter().flat_map(|l| l.colour).all(|c| (0.0..=1.0).contains(&c)));
}
