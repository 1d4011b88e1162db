// Job type of Flamenco 3: bakes the lamps of a list in parts, then writes the page.
// Copy it into the folder `scripts` beside the Flamenco Manager.
const JOB_TYPE = {
    label: "lumitree bake",
    settings: [
        { key: "lamps", type: "string", subtype: "file_path", required: true,
          description: "Text file that lists the luminaires, one a line" },
        { key: "folder", type: "string", subtype: "dir_path", required: true,
          description: "Folder of the assets, which all workers share" },
        { key: "tasks", type: "int32", default: 100, description: "Number of parts" },
        { key: "quality", type: "string", choices: ["preview", "standard", "high"],
          default: "standard" },
    ],
};

function compileJob(job) {
    const settings = job.settings;
    const collect = author.Task("collect", "misc");
    collect.addCommand(author.Command("exec", {
        exe: "lumitree",
        args: ["collect", settings.folder],
    }));
    for (let number = 1; number <= settings.tasks; number++) {
        const task = author.Task("bake " + number, "misc");
        task.addCommand(author.Command("exec", {
            exe: "lumitree",
            args: [
                "bake", "@" + settings.lamps, "-o", settings.folder + "/",
                "--quality", settings.quality, "--task", number + "/" + settings.tasks,
            ],
        }));
        job.addTask(task);
        collect.addDependency(task);
    }
    job.addTask(collect);
}
