#!/bin/bash
# One rank of a training; torchrun starts it. The folder of the run lies on a shared disk.
#   export TORCH_DISABLE_SHARE_RDZV_TCP_STORE=1
#   torchrun --nproc-per-node 2 --max-restarts 3 --no-python bash fit.sh
set -euo pipefail
if [ "${TORCHELASTIC_USE_AGENT_STORE:-False}" = True ]; then
    # Restarted ranks find addresses of the ranks before in a store that they share with the agents.
    echo "fit.sh: restarted ranks would hang; export TORCH_DISABLE_SHARE_RDZV_TCP_STORE=1 first" >&2
    exit 1
fi
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
