# A worker on CPUs: predict, perceive, evaluate, check, corrupt, health. No CUDA, no training.
#   docker build --tag sightline .
#   docker run --rm --volume "$PWD:/data" --user "$(id -u)" sightline check /data/KITTI
# With OpenVINO, 0.3 GB more: docker build --build-arg EXTRAS=[export] --tag sightline .

FROM python:3.12-slim AS build
ARG EXTRAS=""
COPY constraints.txt LICENSE NOTICE README.md pyproject.toml /source/
COPY src /source/src
WORKDIR /source
# uv knows the index of PyTorch without CUDA.
RUN python -m venv /opt/sightline \
    && pip install --no-cache-dir "uv>=0.9,<1" \
    && uv pip install --no-cache --python /opt/sightline/bin/python --torch-backend cpu \
        --constraint constraints.txt "/source${EXTRAS}" \
    && find /opt/sightline/lib -type d \( -name tests -o -path '*/torch/include' \) -prune \
        -exec rm -r {} + \
    && /opt/sightline/bin/pip uninstall --yes pip

FROM python:3.12-slim
COPY --from=build /opt/sightline /opt/sightline
RUN useradd --uid 1000 --create-home worker
USER 1000
WORKDIR /home/worker
# Compiled kernels and converted networks go to the cache; a volume there keeps them.
ENV PATH=/opt/sightline/bin:$PATH XDG_CACHE_HOME=/tmp/cache OMP_NUM_THREADS=1
ENTRYPOINT ["sightline"]
CMD ["--help"]
