# Slipstitch with the versions of the lock.
FROM python:3.11-slim-bookworm

# Blender's libraries.
COPY envs/system-packages.txt /tmp/
RUN apt-get update \
    && grep -v '^#' /tmp/system-packages.txt \
    | xargs apt-get install -y --no-install-recommends \
    && rm -rf /var/lib/apt/lists/* /tmp/system-packages.txt

# Packages change less often than sources. PyTorch without CUDA: a tenth of the size.
COPY envs/requirements.lock /tmp/
RUN pip install --no-cache-dir --extra-index-url https://download.pytorch.org/whl/cpu \
    -r /tmp/requirements.lock \
    && rm /tmp/requirements.lock

COPY . /tmp/slipstitch
RUN pip install --no-cache-dir --no-deps --no-build-isolation /tmp/slipstitch \
    && rm -r /tmp/slipstitch \
    && slipstitch init /workflow \
    && slipstitch doctor

# Results, Snakemake's own files and Warp's kernels go to the mounted folder.
WORKDIR /work
ENV HOME=/work
ENTRYPOINT []
CMD ["snakemake", "--snakefile", "/workflow/Snakefile", "--cores", "all", "all"]
