# DOLFINx 0.9 as Debian 13 has it, and what the demos and the tests need. It runs the tests:
#
#     docker build -t hypergap-dolfinx . && docker run --rm hypergap-dolfinx

FROM debian:trixie-slim

# python3-dolfinx depends on all that C++ programs on top of DOLFINx might need. What no Python
# program opens is not unpacked: documentation, Boost's headers, static libraries, compilers of other
# languages than C (FFCx writes C), AMD's GPU libraries behind Open MPI.
RUN { printf 'path-exclude=%s\n' '/usr/share/doc/*' '*.a' && \
      printf 'path-include=%s\n' '/usr/share/doc/*/copyright' '*/libgcc*.a' '*/libc_nonshared.a' && \
      printf 'path-exclude=%s\n' \
        '/usr/include/boost/*' '/usr/lib/debug/*' '/usr/share/javascript/*' '/usr/share/locale/*' \
        '/usr/share/doc/libboost*' '/usr/share/man/*' '/usr/share/opencascade/data/*' \
        '/usr/share/unicode/*' '/usr/libexec/gcc/*/cc1plus' '/usr/libexec/gcc/*/f951' \
        '/usr/libexec/gcc/*/lto1' '/usr/bin/*-lto-dump-*' '/usr/bin/cmake' '/usr/bin/cpack' \
        '/usr/bin/ctest' '/usr/share/cmake-*' '*/valgrind/*' '*/libLLVM-17.so*' \
        '*/libamd_comgr.so*' '*/libamdhip64.so*'; \
    } > /etc/dpkg/dpkg.cfg.d/small \
    && apt-get update \
    && DEBIAN_FRONTEND=noninteractive apt-get install --yes --no-install-recommends \
        python3-dolfinx python3-gmsh python3-hypothesis python3-pytest python3-pytest-xdist \
        python3-pyvista python3-scipy xvfb \
    && apt-get clean \
    && rm -rf /var/lib/apt/lists/* /var/cache/debconf/*-old /var/log/* \
    && useradd --create-home fenics \
    && install --directory --mode 1777 /home/fenics /hypergap/results

# Any user may run it (docker run --user ...); forms are compiled into the home's cache.
# Open MPI: as many ranks as asked for, root too, through shared memory alone.
ENV HOME=/home/fenics \
    LANG=C.UTF-8 \
    OMP_NUM_THREADS=1 \
    OMPI_ALLOW_RUN_AS_ROOT=1 \
    OMPI_ALLOW_RUN_AS_ROOT_CONFIRM=1 \
    OMPI_MCA_btl=self,sm \
    OMPI_MCA_mpi_yield_when_idle=1 \
    OMPI_MCA_pml=ob1 \
    OMPI_MCA_smsc=^cma \
    PRTE_MCA_rmaps_default_mapping_policy=:oversubscribe \
    PYTEST_ADDOPTS="-p no:cacheprovider" \
    PYTHONDONTWRITEBYTECODE=1 \
    PYTHONPATH=/hypergap \
    TESTS_RAN=/tmp/tests-ran.txt

WORKDIR /hypergap
COPY . .
USER fenics
CMD ["sh", "-c", "python3 -m pytest -n auto --maxprocesses 4 --dist worksteal && \
    mpirun -n 2 python3 -m pytest && echo && echo Tests that ran: && cat $TESTS_RAN"]
