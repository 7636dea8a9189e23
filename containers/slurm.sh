#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
# A Slurm job on one node with the Apptainer image. From the repository's root:
#   sbatch containers/slurm.sh demos/sphere/sphere.py --h 0.07
#SBATCH --job-name=dolfinx_mortar
#SBATCH --nodes=1
#SBATCH --ntasks=16
#SBATCH --cpus-per-task=1
#SBATCH --mem-per-cpu=4G
#SBATCH --time=02:00:00
#SBATCH --output=%x-%j.log
set -euo pipefail

[ "$#" -gt 0 ] || { echo "usage: sbatch containers/slurm.sh PROGRAM [OPTION...]" >&2; exit 2; }
image=${DOLFINX_MORTAR_IMAGE:-dolfinx_mortar.sif}
[ -f "$image" ] || {
  echo "$image not found: apptainer build dolfinx_mortar.sif containers/dolfinx_mortar.def" >&2; exit 2; }

# Forms are compiled once, into a folder that all ranks and later jobs share. The ranks are started by the image's own
# mpirun: inside of one node it needs nothing of the cluster's.
export XDG_CACHE_HOME=${XDG_CACHE_HOME:-$PWD/.cache}
mkdir -p "$XDG_CACHE_HOME"
ranks=${SLURM_NTASKS:-1}
unset "${!SLURM_@}" # or mpirun would look for Slurm's programs, which are not in the image
exec apptainer exec --bind "$PWD" "$image" mpirun -n "$ranks" python3 "$@"
