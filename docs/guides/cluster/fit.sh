#!/bin/bash
# One rank of a training; torchrun starts it. The folder of the run lies on a shared disk.
#   torchrun --nproc-per-node 2 --no-python bash fit.sh
set -euo pipefail
RECIPE=${RECIPE:-detection2d-best}
DATA=${DATA:-street-8k}
RUN=${RUN:-runs/$RECIPE}
resume=()
if [ -f "$RUN/last.ckpt" ]; then
    resume=(--ckpt_path last)
fi
exec sightline fit --config "$RECIPE" --data.init_args.root "$DATA" --run_folder "$RUN" \
    --trainer.accelerator "${ACCELERATOR:-gpu}" --trainer.strategy ddp \
    --trainer.num_nodes "${NUM_NODES:-1}" --trainer.devices "${RANKS_PER_NODE:-2}" \
    --checkpoint_every_n_steps "${CHECKPOINT_STEPS:-500}" "${resume[@]}" "$@"
