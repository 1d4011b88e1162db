#!/bin/bash
#SBATCH --job-name=lumitree
#SBATCH --array=1-100
#SBATCH --cpus-per-task=8
#SBATCH --time=12:00:00
#SBATCH --signal=TERM@120
#SBATCH --output=lumitree-%a.log

# Bakes the lamps that lamps.txt lists, one a line, into the folder baked.
#
#     job=$(sbatch --parsable slurm.sh)
#     sbatch --dependency=afterany:$job --wrap "lumitree collect baked"
#
# The same two commands bake what is missing: SIGTERM, two minutes before the end of the time, makes
# a bake save its state.
set -euo pipefail

# Of an array 1-100 in steps of 1, as above, the tasks have these numbers.
task="$SLURM_ARRAY_TASK_ID/$SLURM_ARRAY_TASK_COUNT"

# Tasks of srun do not inherit the number of processors in all versions of Slurm.
exec srun --cpus-per-task="$SLURM_CPUS_PER_TASK" lumitree bake @lamps.txt -o baked/ --quality standard --task "$task"
