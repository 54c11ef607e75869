//! Datasets that are made in parts: shards, in one folder or in several, and what collects them.

use super::*;
use neumip::dataset::{Shard, generate_shard};

fn make_shard(folder: &Path, index: usize, count: usize, existing: Existing) -> Result<()> {
    generate_shard(&NOISY, &small(), Shard { index, count }, folder, existing, &mut go)
}

fn copy(from: &Path, to: &Path) {
    for (name, bytes) in contents(from) {
        std::fs::write(to.join(name), bytes).unwrap();
    }
}

#[test]
fn shards_give_the_same_bytes_as_one_run() {
    let whole = tempfile::tempdir().unwrap();
    make(whole.path(), &small());
    let expected = contents(whole.path());
    for shared in [true, false] {
        let folder = tempfile::tempdir().unwrap();
        for index in [2, 1, 3] {
            let own = tempfile::tempdir().unwrap();
            let place = if shared { folder.path() } else { own.path() };
            make_shard(place, index, 3, Existing::Refuse).unwrap();
            assert!(Dataset::open(place).is_err());
            if !shared {
                copy(own.path(), folder.path());
            }
        }
        let made = contents(folder.path());
        assert!(made.contains_key("shard-2-of-3.json"));
        let refused = generate(&NOISY, &small(), folder.path(), Existing::Refuse, &mut go).unwrap_err();
        assert!(refused.to_string().contains("holds shards"), "{refused}");
        let mut rays = 0;
        generate(&NOISY, &small(), folder.path(), Existing::Resume, &mut |progress| {
            rays = progress.rays;
            ControlFlow::Continue(())
        })
        .unwrap();
        assert_eq!((contents(folder.path()) == expected, rays), (true, 0));
    }
}

#[test]
fn what_shards_left_out_is_made() {
    let whole = tempfile::tempdir().unwrap();
    make(whole.path(), &small());
    let folder = tempfile::tempdir().unwrap();
    make_shard(folder.path(), 2, 3, Existing::Refuse).unwrap();
    // The third is stopped after two chunks; what it has is used too.
    let mut left = 2;
    let shard = Shard { index: 3, count: 3 };
    let stopped = generate_shard(&NOISY, &small(), shard, folder.path(), Existing::Refuse, &mut |progress| {
        assert!(progress.done <= progress.total);
        left -= 1;
        if left == 0 { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    });
    assert!(matches!(stopped, Err(Error::Interrupted(_))));
    // The collection is stopped and resumed as well.
    let mut first = None;
    let stopped = generate(&NOISY, &small(), folder.path(), Existing::Resume, &mut |progress| {
        first.get_or_insert(progress);
        if progress.split == "train" { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    });
    assert!(matches!(stopped, Err(Error::Interrupted(_))));
    let first = first.unwrap();
    assert!(3 * first.done > first.total && first.done < first.total, "{first:?}");
    Dataset::open(folder.path()).unwrap();
    generate(&NOISY, &small(), folder.path(), Existing::Resume, &mut go).unwrap();
    assert!(contents(folder.path()) == contents(whole.path()));
}

#[test]
fn a_shard_is_resumed_and_replaced() {
    let folder = tempfile::tempdir().unwrap();
    make_shard(folder.path(), 1, 2, Existing::Refuse).unwrap();
    let before = contents(folder.path());
    let refused = make_shard(folder.path(), 1, 2, Existing::Refuse).unwrap_err();
    assert!(refused.to_string().contains("shard-1-of-2.json"), "{refused}");
    std::fs::remove_file(folder.path().join("train-00001.exr")).unwrap();
    std::fs::write(folder.path().join("test-00000.exr"), "damaged").unwrap();
    make_shard(folder.path(), 1, 2, Existing::Resume).unwrap();
    assert!(contents(folder.path()) == before);
    make_shard(folder.path(), 1, 2, Existing::Replace).unwrap();
    assert!(contents(folder.path()) == before);
    assert!(matches!(make_shard(folder.path(), 1, 2, Existing::Append), Err(Error::Usage(_))));
    assert!(make_shard(folder.path(), 3, 2, Existing::Refuse).unwrap_err().to_string().contains("3/2"));
}

#[test]
fn shards_of_something_else_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    make_shard(folder.path(), 1, 2, Existing::Refuse).unwrap();
    let other = GenerateConfig { grazing_floor: 0.2, ..small() };
    for refused in [
        generate(&NOISY, &other, folder.path(), Existing::Resume, &mut go).map(drop),
        generate_shard(
            &NOISY,
            &other,
            Shard { index: 1, count: 2 },
            folder.path(),
            Existing::Resume,
            &mut go,
        ),
    ] {
        let line = refused.unwrap_err().to_string();
        assert!(line.contains("shard-1-of-2.json: generation.grazing_floor differs"), "{line}");
    }
    let whole = contents(folder.path());
    let path = folder.path().join("shard-1-of-2.json");
    let text = String::from_utf8(whole["shard-1-of-2.json"].clone()).unwrap();
    for (from, to) in [
        ("\"blocks\": 64", "\"blocks\": 4611686018427387904"),
        ("\"name\": \"train-00001\"", "\"name\": \"../train-00001\""),
        ("\"frame_bytes\": ", "\"frame_bytes\": 1"),
        ("{", ""),
    ] {
        assert!(text.contains(from), "{from}");
        std::fs::write(&path, text.replacen(from, to, 1)).unwrap();
        let error = generate(&NOISY, &small(), folder.path(), Existing::Resume, &mut go).unwrap_err();
        assert!(!error.to_string().contains('\n'), "{error}");
        std::fs::remove_file(folder.path().join(MANIFEST)).ok();
    }
    std::fs::write(&path, text).unwrap();
    generate(&NOISY, &small(), folder.path(), Existing::Resume, &mut go).unwrap();

    let refused = make_shard(folder.path(), 1, 2, Existing::Resume).unwrap_err();
    assert!(refused.to_string().contains("holds a dataset already"), "{refused}");
    let foreign = tempfile::tempdir().unwrap();
    std::fs::write(foreign.path().join("notes.txt"), "mine").unwrap();
    let refused = make_shard(foreign.path(), 1, 2, Existing::Replace).unwrap_err();
    assert!(refused.to_string().contains("not a dataset"), "{refused}");
}
