"""Running a sweep: here or on a cluster, in memory, stored, lazy."""

import functools
import math
import os
import sys
import warnings
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike
from tqdm.auto import tqdm

from slippulse_jax.base.choices import RightEnd
from slippulse_jax.base.files import shortened
from slippulse_jax.block import ContactLaw, Control, Top
from slippulse_jax.bulk.chunks import in_this_thread
from slippulse_jax.interface import Interface
from slippulse_jax.slider import Slider
from slippulse_jax.sweeps.dataset import labelled, processor
from slippulse_jax.sweeps.outputs import OUTPUTS, choose, evaluate
from slippulse_jax.sweeps.request import PARAMETERS, Columns, Region, Request, chunk_shape, make_axes, regions, shape_of
from slippulse_jax.sweeps.store import StoreError, check_same, create, fill, is_complete, is_store, open_arrays, open_store

if TYPE_CHECKING:
    from distributed import Client

OF_LENGTHS, OF_BLOCKS, OF_OTHERS = 1 << 20, 1 << 7, 1 << 14
"""Points per chunk by default: of quick outputs, of blocks, and of all others."""

TASKS, POINTS_PER_TASK = 256, 1 << 12
"""Chunks of a sweep on Dask without a store, and fewest points of each."""

QUICK = {"length", "contacts_broken", "status", "edge_stress", "is_one_domino", "nucleation_load", "b", "slow_decay_length"}
"""Outputs that take no longer than lengths."""

TIMEOUT = 10
"""Seconds to wait for a scheduler to answer."""

Done = tuple[Region, Columns, set[str]]
"""A chunk, its values unless they went to a store, and what to warn of."""


def sweep(
    *,
    height: ArrayLike,
    stiffness: ArrayLike,
    poisson: ArrayLike,
    prestress: ArrayLike | None = None,
    threshold_slope: ArrayLike | None = None,
    residual_strength: ArrayLike | None = None,
    width: ArrayLike | None = None,
    push_height: ArrayLike | None = None,
    push_width: ArrayLike | None = None,
    push_control: Control = "displacement",
    friction: ArrayLike | None = None,
    normal_stiffness: ArrayLike | None = None,
    contact_law: ContactLaw = "amontons",
    top: Top = "free",
    interface: Interface | None = None,
    points: bool = False,
    outputs: str | tuple[str, ...] | list[str] = ("length", "status"),
    right: RightEnd = "semi-infinite",
    sites: int | None = None,
    store: str | os.PathLike[str] | None = None,
    resume: bool = True,
    chunk: int | None = None,
    share: tuple[int, int] | None = None,
    client: "Client | str | None" = None,
    lazy: bool = False,
    progress: bool | None = None,
) -> xr.Dataset:
    """Compute first precursors over ranges of parameters, as a labelled dataset.

    Parameters
    ----------
    height, stiffness, poisson : array_like
        H/λc, k/K and ν: each a number, or a one-dimensional array, which becomes an axis.
    prestress, threshold_slope, residual_strength : array_like, optional
        Parameters of the interface to sweep, likewise; as for `Interface`.
    width : array_like, optional
        Width of the smooth break rule, in σ_s, for the output ``smooth_length``.
    push_height, push_width : array_like, optional
        Height of the push on a block and of the pusher itself, over H, for the output ``block_precursor_length``: as for
        `Push`.
    push_control : {"displacement", "force"}
        What is held while an event of a block runs.
    friction, normal_stiffness : array_like, optional
        μ and k_n/k of a block, as for `Block`; a length is NaN where the block lifts off.
    contact_law : {"amontons", "multicontact"}
    top : {"free", "held"}
        As for `Block`.
    interface : Interface, optional
        Of numbers, for the parameters of the interface that are fixed.
    points : bool
        Take the arrays together, as points, instead of every combination.
    outputs : str or sequence of str
        Names of `slippulse_jax.sweeps.outputs.OUTPUTS`, or "gradients", "theory", "validity".
    right, sites
        As for `precursor_length`.
    store : path or str, optional
        Folder to write the result to as it is computed, in constant memory, as a Zarr group; or any address that fsspec knows,
        such as ``"s3://bucket/scan.zarr"``. A sweep found there is resumed.
    resume : bool
        Whether a sweep found in `store` may be resumed.
    chunk : int, optional
        Largest number of points per chunk of the store, or per task.
    share : (int, int), optional
        Index and number of the processes that share the store without a scheduler. Chunk i belongs to process i mod number.
    client : dask.distributed.Client or str, optional
        Cluster on which the chunks are computed, each on one thread of a worker; or the address of its scheduler, such as
        ``"tcp://node0:8786"``. With a store the workers write it themselves.
    lazy : bool
        Return dask arrays: a chunk is computed when one of its values is needed.
    progress : bool, optional
        Show a progress bar, on stderr or in the notebook; by default only on a terminal.

    Returns
    -------
    xarray.Dataset
        One variable per output, one dimension per axis, in float64, with units, versions and request as attributes. A
        stored sweep is read on demand. Attribute ``complete`` is 0 while shares of other processes are missing.

    Raises
    ------
    ValueError
        If a parameter or an output is not valid, or no scheduler answers, before anything is computed.
    StoreError
        A `ValueError`: if the store belongs to another request, is damaged, or is no store.

    Warns
    -----
    RuntimeWarning
        If a chunk of the store is damaged, or if a store begun on another processor or with other versions is resumed: the
        last digits may then differ from chunk to chunk.

    Notes
    -----
    The bits of a point depend on its own parameters, the processor and the versions alone: not on chunks, resuming, processes
    or number of devices.
    """
    every: dict[str, Any] = locals().copy()
    if isinstance(client, str):
        with connected(client) as every["client"]:
            return sweep(**every)
    given = {name: value for name, value in every.items() if name in PARAMETERS}
    axes = make_axes(given, interface, points=points, push_control=push_control, contact_law=contact_law, top=top)
    right = Slider(2, 1, 0, length=sites, right=None if right == "semi-infinite" else right).right  # which checks it
    request = Request(axes, choose(outputs, map(str, axes.coords)), right, sites, push_control, contact_law, top)
    _check_options(request, store, chunk, share, client, lazy)
    most = chunk or default_chunk(request, tasks=lazy or (client is not None and store is None))
    most = min(most, -(-math.prod(request.shape) // share[1])) if share and not chunk else most  # one for every process
    if lazy:
        return _lazily(request, most)
    if store is None:
        columns = {name: np.empty(request.shape, OUTPUTS[name].dtype) for name in request.outputs}
        for region, values in _run(functools.partial(_compute, request, None), regions(request.shape, most), client, progress):
            for name in request.outputs:
                columns[name][region] = values[name]
        return labelled(request, columns, complete=1)
    url = os.fspath(store)
    resumed = is_store(url)
    if resumed and not resume:
        raise StoreError(f"{url}: holds a sweep already; resume it, or give another folder")
    if not resumed:
        create(url, request, most, processor() if client is None else client.submit(processor).result())
    stored, held = open_store(url)
    check_same(stored, held, request, chunk)
    chunks = regions(request.shape, stored.attrs["chunk"])
    chunks = chunks[share[0] :: share[1]] if share else chunks
    if resumed:  # another process may be at work, in another order, so that two rarely compute the same chunk
        np.random.default_rng().shuffle(chunks)
    compute = functools.partial(_compute, request, (stored.attrs, open_arrays(url, request)))
    for _ in _run(compute, chunks, client, progress):
        pass
    return open_sweep(url)


def open_sweep(store: str | os.PathLike[str]) -> xr.Dataset:
    """Open a stored sweep, finished or not.

    Values of the labelled dataset are read on demand. Points not yet computed are NaN (−1 in whole numbers), and the attribute
    ``complete`` is 0 then. ``xarray.open_zarr`` opens it too, without the checks and without this package.

    Raises
    ------
    StoreError
        If there is no sweep, or a damaged one. A damaged chunk is an error of Zarr's when it is read; the same sweep, resumed,
        names it and computes it again.
    """
    stored, request = open_store(os.fspath(store))
    return stored.assign_attrs(complete=int(is_complete(stored, request)))


def default_chunk(request: Request, *, tasks: bool) -> int:
    """Points per chunk: few files, but little lost to a kill."""
    chunk = OF_LENGTHS if {*request.outputs} <= QUICK else OF_OTHERS
    chunk = OF_BLOCKS if "block_precursor_length" in request.outputs else chunk
    return min(chunk, max(POINTS_PER_TASK, -(-math.prod(request.shape) // TASKS))) if tasks else chunk


def _check_options(request: Request, store: Any, chunk: int | None, share: Any, client: Any, lazy: bool) -> None:
    """Check that outputs, chain, and options of computing go together."""
    slope, kept = (request.axes.get(name, 0) != 0 for name in ("threshold_slope", "residual_strength"))
    for name in request.outputs:
        if name in ("exact_length", "exact_status") and np.any(slope & kept):
            raise ValueError(f"output {name!r} takes threshold_slope or residual_strength, not both: ask for length and status")
        if request.right != "semi-infinite" and "right" not in OUTPUTS[name].takes:
            raise ValueError(f"output {name!r} is for a semi-infinite chain, not right = {request.right!r}")
    if chunk is not None and chunk < 1:
        raise ValueError(f"chunk = {chunk}: must be at least one point")
    if lazy and (store is not None or client is not None):
        raise ValueError("lazy = True takes no store and no client: dask computes the dataset wherever it computes others")
    if share is not None and not 0 <= share[0] < share[1]:
        raise ValueError(f"share {share[0]} of {share[1]}: shares count from 0 to the number of processes less one")
    if share is not None and client is not None:
        raise ValueError("share is for processes without a scheduler: leave it out with a client")
    if share is not None and store is None:
        raise ValueError(f"{share[1]} processes share this sweep: give it a store they can all write to")
    if client is not None and not isinstance(client, getattr(sys.modules.get("distributed"), "Client", ())):
        kind = type(client).__name__
        raise TypeError(f'client is {kind}: must be a distributed.Client, or an address such as "tcp://node0:8786"')


def connected(address: str) -> "Client":
    """Connect to a Dask scheduler; a ValueError if none answers."""
    try:
        from distributed import Client
    except ImportError:
        raise ModuleNotFoundError("a scheduler needs Dask: pip install 'slippulse_jax[cluster]'") from None
    try:
        return Client(address, timeout=TIMEOUT)
    except (OSError, ValueError) as error:
        raise ValueError(f"no Dask scheduler answers at {address} ({shortened(str(error))})") from None


def _run(
    compute: Callable[[Region], Done], chunks: list[Region], client: "Client | None", progress: bool | None
) -> Iterator[tuple[Region, Columns]]:
    """Compute chunks here or on a cluster, with a progress bar."""
    size = sum(math.prod(shape_of(region)) for region in chunks)
    hidden = None if progress is None else not progress  # by default it is shown on a terminal only
    said: set[str] = set()
    with tqdm(total=size, unit=" points", unit_scale=True, disable=hidden, desc="sweep") as bar:
        for region, columns, remarks in map(compute, chunks) if client is None else _on_workers(client, compute, chunks):
            for remark in remarks - said:
                warnings.warn(remark, RuntimeWarning, stacklevel=3)
            said |= remarks
            yield region, columns
            bar.update(math.prod(shape_of(region)))


def _compute(request: Request, store: tuple[dict[str, Any], dict[str, Any]] | None, region: Region) -> Done:
    """Compute a chunk, or fill it in a store."""
    if store is None:
        return region, evaluate(request, region), set()
    return region, {}, fill(*store, region, lambda: evaluate(request, region))


@in_this_thread()
def _alone(region: Region, compute: Callable[[Region], Done]) -> Done:
    """Compute a chunk in this thread, beside other threads of a worker."""
    return compute(region)


def _on_workers(client: "Client", compute: Callable[[Region], Done], chunks: list[Region]) -> Iterator[Done]:
    """Compute chunks on a cluster, each on one thread, as they finish."""
    from distributed import as_completed

    futures = client.map(_alone, chunks, compute=compute, pure=False, retries=2)
    try:
        for future, done in as_completed(futures, with_results=True):
            yield done
            future.release()
    except BaseException:
        client.cancel(futures)
        raise


def _lazily(request: Request, points: int) -> xr.Dataset:
    """Make a dataset of Dask arrays, one task per function and chunk."""
    import dask.array as da
    from dask.array.core import normalize_chunks

    chunk = normalize_chunks(chunk_shape(request.shape, points), request.shape)
    data = {}
    for function in dict.fromkeys(OUTPUTS[name].function for name in request.outputs):
        part = request._replace(outputs=tuple(name for name in request.outputs if OUTPUTS[name].function is function))
        dtype = np.dtype([(name, OUTPUTS[name].dtype) for name in part.outputs])
        meta = np.empty((0,) * len(chunk), dtype)
        computed = da.map_blocks(functools.partial(_block, part, dtype), chunks=chunk, dtype=dtype, meta=meta)
        data |= {name: computed[name] for name in part.outputs}
    return labelled(request, data, complete=1)


@in_this_thread()
def _block(request: Request, dtype: np.dtype, block_info: Any = None) -> np.ndarray:
    """Compute one chunk for dask; one record per point."""
    region = tuple(slice(*ends) for ends in block_info[None]["array-location"])
    return np.rec.fromarrays([*evaluate(request, region).values()], dtype)
