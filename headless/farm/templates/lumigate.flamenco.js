// Job type for Flamenco 3 (https://flamenco.blender.org): Lumigate's indirect light of a range of frames.
//
// Put this file into the Manager's `scripts` folder.  Every worker needs the same `lumigate` as the others on its PATH (or its path
// in the setting `lumigate`), and the .blend file and the output on shared storage, under the same path.
// A task renders a run of frames of the whole sequence (`--part`), which gives the same bits wherever it runs; `--skip-existing`
// makes a task that is run again go on where it was.

const JOB_TYPE = {
    label: "Lumigate: indirect light",
    settings: [
        { key: "frames", type: "string", required: true, eval: "f'{C.scene.frame_start}-{C.scene.frame_end}'",
          description: "Frames FIRST-LAST of the whole sequence" },
        { key: "chunk_size", type: "int32", default: 32, visible: "submission",
          description: "Frames of a task; the first of each needs the light of the 7 before it" },
        { key: "blendfile", type: "string", required: true, eval: "bpy.data.filepath", visible: "web",
          description: "The scene" },
        { key: "output_file", type: "string", subtype: "file_path", required: true,
          description: "OUT.exr, which becomes OUT0001.exr and so on; #### stand for the number" },
        { key: "options", type: "string", default: "",
          description: "Further options of `lumigate render`, as in --samples 16 --size 1920x1080" },
        { key: "lumigate", type: "string", default: "lumigate", visible: "web",
          description: "The command on the workers" },
    ],
};

function compileJob(job) {
    const settings = job.settings;
    const ends = settings.frames.match(/^(-?\d+)-(-?\d+)$/);
    if (!ends) {
        throw new Error("frames: '" + settings.frames + "' is not FIRST-LAST, as in 1-250");
    }
    const first = parseInt(ends[1], 10);
    const last = parseInt(ends[2], 10);
    const extra = settings.options.split(/\s+/).filter(function (word) { return word.length > 0; });
    for (let begin = first; begin <= last; begin += settings.chunk_size) {
        const part = begin + "-" + Math.min(last, begin + settings.chunk_size - 1);
        const task = author.Task("lumigate-" + part, "blender");
        task.addCommand(author.Command("exec", {
            exe: settings.lumigate,
            args: ["render", settings.blendfile, "-o", settings.output_file, "--frames", settings.frames, "--part", part,
                   "--skip-existing"].concat(extra),
        }));
        job.addTask(task);
    }
}
