"""The templates for farms: each is valid, and its commands are those of lumitree."""

import json
import re
import shutil
import subprocess
from pathlib import Path

import pytest

from lumitree.cli.app import _parser

FARM = Path(__file__).parent.parent / "examples" / "farm"
NODE = shutil.which("node")


def check_bake(arguments, task):
    """Arguments of a command that bakes a part of a list."""
    args = _parser().parse_args(arguments)
    assert args.luminaires[0].startswith("@")
    assert args.output.endswith("/")
    assert args.task == task
    assert args.quality == "standard"


def test_every_template_is_on_the_page():
    page = (FARM.parents[1] / "docs" / "how-to" / "farms.md").read_text()
    names = sorted(path.name for path in FARM.iterdir())
    assert names == ["flamenco.js", "kubernetes.yaml", "openjd.yaml", "slurm.sh"]
    for name in names:
        assert f"examples/farm/{name}" in page


def test_slurm(tmp_path):
    """The script starts the command with the numbers of the array."""
    script = FARM / "slurm.sh"
    subprocess.run(["bash", "-n", script], check=True)
    (tmp_path / "srun").write_text('#!/bin/sh\nprintf "%s\\n" "$@"\n')
    (tmp_path / "srun").chmod(0o755)
    environment = {
        "PATH": f"{tmp_path}:/usr/bin:/bin",
        "SLURM_ARRAY_TASK_ID": "7",
        "SLURM_ARRAY_TASK_COUNT": "100",
        "SLURM_CPUS_PER_TASK": "8",
    }
    run = subprocess.run(
        ["bash", script], env=environment, capture_output=True, text=True, check=True
    )
    cores, program, *arguments = run.stdout.splitlines()
    assert (cores, program) == ("--cpus-per-task=8", "lumitree")
    check_bake(arguments, (7, 100))
    assert "#SBATCH --array=1-100\n" in script.read_text()


def test_kubernetes():
    yaml = pytest.importorskip("yaml")
    job = yaml.safe_load((FARM / "kubernetes.yaml").read_text())
    assert (job["kind"], job["spec"]["completionMode"]) == ("Job", "Indexed")
    (container,) = job["spec"]["template"]["spec"]["containers"]
    shell = container["command"][-1].replace("exec lumitree", 'printf "%s\\n"')
    run = subprocess.run(
        ["sh", "-c", shell], env={"JOB_COMPLETION_INDEX": "0"}, capture_output=True, text=True
    )
    check_bake(run.stdout.splitlines(), (1, job["spec"]["completions"]))
    names = {volume["name"] for volume in job["spec"]["template"]["spec"]["volumes"]}
    assert {mount["name"] for mount in container["volumeMounts"]} == names


def test_openjd():
    model = pytest.importorskip("openjd.model")
    yaml = pytest.importorskip("yaml")
    content = yaml.safe_load((FARM / "openjd.yaml").read_text())
    template = model.decode_job_template(template=content)
    values = model.preprocess_job_parameters(
        job_template=template,
        job_parameter_values={"Lamps": "/w/lamps.txt", "Folder": "/w/baked", "Tasks": "3"},
        job_template_dir=FARM,
        current_working_dir=FARM,
    )
    job = model.create_job(job_template=template, job_parameter_values=values)
    bake, collect = job.steps
    space = model.StepParameterSpaceIterator(space=bake.parameterSpace)
    assert [parameters["Task"].value for parameters in space] == ["1", "2", "3"]
    assert [each.dependsOn for each in collect.dependencies] == ["Bake"]
    known = {"Param.Lamps": "/w/lamps.txt", "Param.Folder": "/w/baked", "Param.Tasks": "3",
             "Param.Quality": "standard", "Task.Param.Task": "2"}  # fmt: skip
    arguments = [
        re.sub(r"\{\{(.*?)\}\}", lambda found: known[found[1]], str(argument))
        for argument in content["steps"][0]["script"]["actions"]["onRun"]["args"]
    ]
    check_bake(arguments, (2, 3))
    line = content["steps"][1]["script"]["actions"]["onRun"]["args"]
    assert _parser().parse_args(line).folder == "{{Param.Folder}}"


FLAMENCO = """
const tasks = [];
const author = {
  Command: (name, parameters) => ({name, parameters}),
  Task: (name, type) => {
    const task = {name, type, commands: [], after: []};
    task.addCommand = (command) => task.commands.push(command);
    task.addDependency = (other) => task.after.push(other.name);
    return task;
  },
};
compileJob({
  settings: {lamps: "/w/lamps.txt", folder: "/w/baked", tasks: 3, quality: "standard"},
  addTask: (task) => tasks.push(task),
});
console.log(JSON.stringify({tasks, type: JOB_TYPE}));
"""


@pytest.mark.skipif(NODE is None, reason="needs Node.js")
def test_flamenco():
    script = (FARM / "flamenco.js").read_text() + FLAMENCO
    run = subprocess.run([NODE, "-e", script], capture_output=True, text=True, check=True)
    found = json.loads(run.stdout)
    *bakes, collect = found["tasks"]
    for number, task in enumerate(bakes, 1):
        (command,) = task["commands"]
        assert (command["name"], command["parameters"]["exe"]) == ("exec", "lumitree")
        check_bake(command["parameters"]["args"], (number, 3))
    assert collect["after"] == [task["name"] for task in bakes] == ["bake 1", "bake 2", "bake 3"]
    assert _parser().parse_args(collect["commands"][0]["parameters"]["args"]).folder == "/w/baked"
    keys = {setting["key"] for setting in found["type"]["settings"]}
    assert keys == {"lamps", "folder", "tasks", "quality"}
