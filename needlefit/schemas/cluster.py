"""The file that describes the Slurm jobs in which the workers of a cluster run."""

from typing import Annotated

from pydantic import Field

from needlefit.schemas.base import FileRecord

Text = Annotated[str, Field(min_length=1)]


class SlurmRecord(FileRecord):
    """Workers that Slurm starts; keys other than `jobs` are those of `dask_jobqueue.SLURMCluster`."""

    jobs: int = Field(ge=1, le=10_000)
    """Slurm jobs to submit."""
    cores: int = Field(ge=1)
    """Cores of each job."""
    memory: Text
    """Memory of each job: `"4GB"`."""
    processes: int = Field(1, ge=1)
    """Workers in each job; one for each core uses all of them."""
    walltime: Text | None = None
    """Time limit of each job: `"02:00:00"`."""
    queue: Text | None = None
    """Partition."""
    account: Text | None = None
    """Account that is charged."""
    interface: Text | None = None
    """Network interface of scheduler and workers: `"ib0"`."""
    shared_temp_directory: Text
    """Folder that all nodes see, for the TLS certificates of this run, which only you can read."""
    job_extra_directives: tuple[Text, ...] = ()
    """Further options of `sbatch`."""
    job_script_prologue: tuple[Text, ...] = ()
    """Commands before a worker starts: modules to load, an environment to activate."""
