//! A private Python environment for tests: made under the build folder, reused while it is what the tests ask for.

use std::ffi::{OsStr, OsString};
use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// Names the interpreter that the environment is made with; absent: `python3`.
const INTERPRETER: &str = "NEUMIP_PYTHON";
/// What is installed: from the first releases that are known to work to before the next incompatible ones.
const REQUIREMENTS: [&str; 4] =
    ["numpy>=1.26,<3", "onnx>=1.17,<2", "onnxruntime>=1.20,<2", "flip-evaluator>=1.7,<2"];

/// An interpreter that has the requirements.
#[derive(Debug)]
pub struct Python {
    program: PathBuf,
    /// Where the packages are, if not in the interpreter's own folders.
    packages: Option<PathBuf>,
}

/// The environment of [`REQUIREMENTS`]; it is made now if there is none. Panics with what is missing.
pub fn environment() -> Python {
    named("python-environment", &REQUIREMENTS).unwrap_or_else(|problem| panic!("{problem}"))
}

/// The environment of `requirements` in the build folder's folder `name`, or what keeps it from being made.
pub fn named(name: &str, requirements: &[&str]) -> Result<Python, String> {
    let interpreter = std::env::var_os(INTERPRETER).unwrap_or_else(|| "python3".into());
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).with_file_name(name);
    prepare(&folder, &interpreter, requirements)
}

impl Python {
    /// A command that runs a script, with the environment's packages and no others.
    pub fn script(&self, script: &Path) -> Command {
        let mut command = Command::new(&self.program);
        // -B: no compiled files beside sources of the repository; -s: no packages of the user.
        command.args(["-B", "-s"]).arg(script).env_remove("PYTHONHOME");
        match &self.packages {
            Some(packages) => command.env("PYTHONPATH", packages),
            None => command.env_remove("PYTHONPATH"),
        };
        command
    }
}

/// Makes the environment in `folder` unless it is there; one at a time, over threads and processes.
fn prepare(folder: &Path, interpreter: &OsStr, requirements: &[&str]) -> Result<Python, String> {
    let identity = identify(interpreter)?;
    let failed = |e: std::io::Error| format!("{}: cannot be prepared: {e}", folder.display());
    fs::create_dir_all(folder).map_err(failed)?;
    let lock = File::create(folder.join("lock")).map_err(failed)?;
    lock.lock().map_err(failed)?;

    let environment = folder.join("environment");
    let own_program = environment.join(if cfg!(windows) { "Scripts/python.exe" } else { "bin/python" });
    let packages = environment.join("packages");
    // Written last: without it, or with another, the environment is half-made or of other requirements.
    let stamp = environment.join("made-of.txt");
    let made_of = format!("{identity}{}\n", requirements.join("\n"));
    if fs::read_to_string(&stamp).ok().as_ref() != Some(&made_of) {
        if environment.exists() {
            fs::remove_dir_all(&environment).map_err(failed)?;
        }
        make(&environment, interpreter, &own_program, &packages, requirements)?;
        fs::write(&stamp, made_of).map_err(failed)?;
    }
    match own_program.exists() {
        true => Ok(Python { program: own_program, packages: None }),
        false => Ok(Python { program: interpreter.into(), packages: Some(packages) }),
    }
}

/// Which interpreter this is: an environment does not outlive a change of it.
fn identify(interpreter: &OsStr) -> Result<String, String> {
    let name = interpreter.display();
    let advice = format!("install Python 3.10 or newer, or name an interpreter in {INTERPRETER}");
    match run(interpreter, &["-c", "import sys; print(sys.executable, sys.version)"]) {
        Ok(output) if output.status.success() => Ok(String::from_utf8_lossy(&output.stdout).into_owned()),
        Ok(output) => {
            Err(format!("the Python interpreter {name} does not work: {}; {advice}", said(&output)))
        }
        Err(e) => Err(format!("the Python interpreter {name} cannot be run: {e}; {advice}")),
    }
}

/// A virtual environment or, where venv is missing, a folder of packages beside the interpreter's own.
fn make(
    environment: &Path,
    interpreter: &OsStr,
    own_program: &Path,
    packages: &Path,
    requirements: &[&str],
) -> Result<(), String> {
    let spawn = |program: &OsStr, arguments: &[&OsStr]| {
        run(program, arguments).map_err(|e| format!("{} cannot be run: {e}", program.display()))
    };
    let mut install: Vec<OsString> =
        ["-m", "pip", "install", "--quiet", "--no-input"].map(OsString::from).into();
    install.push("--disable-pip-version-check".into());
    let mut program = own_program.as_os_str();
    let venv = spawn(interpreter, &["-m".as_ref(), "venv".as_ref(), environment.as_ref()])?;
    if !venv.status.success() {
        // What a failed venv leaves must not be taken for one.
        let _ = fs::remove_dir_all(environment);
        if !spawn(interpreter, &["-m".as_ref(), "pip".as_ref(), "--version".as_ref()])?.status.success() {
            return Err(format!(
                "the Python interpreter {} has neither venv nor pip: install one of them (packages python3-venv, \
                 python3-pip), or name another interpreter in {INTERPRETER}; venv said: {}",
                interpreter.display(),
                said(&venv)
            ));
        }
        fs::create_dir_all(packages).map_err(|e| format!("{}: cannot be made: {e}", packages.display()))?;
        program = interpreter;
        install.extend(["--target".into(), packages.into()]);
    }
    install.extend(requirements.iter().map(OsString::from));
    let arguments: Vec<&OsStr> = install.iter().map(OsString::as_os_str).collect();
    let output = spawn(program, &arguments)?;
    if !output.status.success() {
        return Err(format!(
            "pip cannot install {}: the first run needs a package index (the network, PIP_INDEX_URL or \
             PIP_FIND_LINKS) and a Python that these packages support; pip said: {}",
            requirements.join(" "),
            said(&output)
        ));
    }
    Ok(())
}

fn run(program: &OsStr, arguments: &[impl AsRef<OsStr>]) -> std::io::Result<Output> {
    Command::new(program).args(arguments).env_remove("PYTHONHOME").env_remove("PYTHONPATH").output()
}

fn said(output: &Output) -> String {
    let text = [&output.stdout[..], &output.stderr].concat();
    String::from_utf8_lossy(&text).trim().to_string()
}

/// An interpreter played by a shell script, so that nothing is installed.
#[cfg(unix)]
mod played {
    use super::*;
    use std::io::Write;
    use std::process::Stdio;

    /// Writes down every call; fails at venv or pip where a file `no-venv` or `no-pip` is beside it, at installing where
    /// `no-index` is.
    const SCRIPT: &str = r#"#!/bin/sh
echo "$*" >> 'HERE/calls'
case "$1 $2 $3" in
    "-c "*) echo "played 3" ;;
    "-m venv "*)
        mkdir -p "$3/bin"
        if [ -e 'HERE/no-venv' ]; then echo "no ensurepip" >&2; exit 1; fi
        cp "$0" "$3/bin/python" ;;
    "-m pip --version") [ ! -e 'HERE/no-pip' ] ;;
    "-m pip install") if [ -e 'HERE/no-index' ]; then echo "no route" >&2; exit 1; fi ;;
esac
"#;

    struct Stage(tempfile::TempDir);

    impl Stage {
        fn new() -> Self {
            let stage = Self(tempfile::tempdir().unwrap());
            // Written by another process: a file that any thread of this one has open to write cannot be run.
            let mut shell = Command::new("sh");
            shell
                .args(["-c", r#"cat > "$0" && chmod +x "$0""#])
                .arg(stage.interpreter())
                .stdin(Stdio::piped());
            let mut shell = shell.spawn().unwrap();
            let script = SCRIPT.replace("HERE", stage.0.path().to_str().unwrap());
            shell.stdin.take().unwrap().write_all(script.as_bytes()).unwrap();
            assert!(shell.wait().unwrap().success());
            stage
        }

        fn interpreter(&self) -> OsString {
            self.0.path().join("python").into()
        }

        fn without(&self, part: &str) -> PathBuf {
            let path = self.0.path().join(format!("no-{part}"));
            fs::write(&path, "").unwrap();
            path
        }

        fn prepare(&self, requirements: &[&str]) -> Result<Python, String> {
            prepare(&self.0.path().join("made"), &self.interpreter(), requirements)
        }

        /// How often something was called for.
        fn calls(&self, what: &str) -> usize {
            let calls = fs::read_to_string(self.0.path().join("calls")).unwrap();
            calls.lines().filter(|line| line.starts_with(what)).count()
        }
    }

    #[test]
    fn an_environment_is_reused_until_something_else_is_asked_for() {
        let stage = Stage::new();
        for (requirements, made) in [(["a<2"], 1), (["a<2"], 1), (["a<3"], 2), (["a<3"], 2), (["a<2"], 3)] {
            let python = stage.prepare(&requirements).unwrap();
            assert!(python.program.ends_with("made/environment/bin/python") && python.packages.is_none());
            assert_eq!((stage.calls("-m venv"), stage.calls("-m pip install")), (made, made));
        }
    }

    #[test]
    fn a_half_made_environment_is_remade() {
        let stage = Stage::new();
        let no_index = stage.without("index");
        for tries in 1..3 {
            let problem = stage.prepare(&["a<2", "b"]).unwrap_err();
            assert!(problem.contains("install a<2 b") && problem.contains("no route"), "{problem}");
            assert_eq!(stage.calls("-m venv"), tries);
        }
        fs::remove_file(no_index).unwrap();
        stage.prepare(&["a<2", "b"]).unwrap();
        assert_eq!(stage.calls("-m venv"), 3);
    }

    #[test]
    fn where_venv_is_missing_packages_go_to_a_folder() {
        let stage = Stage::new();
        stage.without("venv");
        for _ in 0..2 {
            let python = stage.prepare(&["a<2"]).unwrap();
            assert_eq!(python.program.as_os_str(), stage.interpreter());
            let packages = python.packages.as_ref().unwrap();
            assert!(packages.ends_with("made/environment/packages"));
            let command = python.script(Path::new("some.py"));
            assert!(command.get_envs().any(|e| e == (OsStr::new("PYTHONPATH"), Some(packages.as_os_str()))));
            assert_eq!(
                stage.calls("-m pip install --quiet --no-input --disable-pip-version-check --target"),
                1
            );
        }
        stage.without("pip");
        let problem = stage.prepare(&["a<3"]).unwrap_err();
        assert!(problem.contains("neither venv nor pip") && problem.contains("no ensurepip"), "{problem}");
    }

    #[test]
    fn a_missing_interpreter_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let problem = prepare(folder.path(), OsStr::new("no-such-python"), &[]).unwrap_err();
        assert!(
            problem.contains("no-such-python cannot be run") && problem.contains(INTERPRETER),
            "{problem}"
        );
    }
}
