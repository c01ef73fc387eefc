"""Taichi's import and its tracer, made quicker; what it traces stays the same to the bit (tests/test_tracing.py).

Taichi walks the source of a kernel in Python before it compiles it, and again in every process before it finds it in its
cache: of a campfire's first frame that was the longest part. It reads, tokenises and parses a function anew wherever it is
inlined, and words the position of every node, with carets and line wrapping, in case it should fail there. Here each
function is read and parsed once, and a position is worded once a line.

Importing this module imports Taichi. It looks through all modules for that of every function it decorates, half of its import.
"""

from __future__ import annotations

import ast
import functools
import importlib
import inspect
import linecache
import operator
import platform
import sys
import textwrap
import traceback
from types import FrameType, ModuleType
from typing import Any

_VERSION = (1, 7, 4)  # whose tracer is replaced; another version keeps its own


def _frame_info(frame: FrameType, context: int = 1) -> tuple[str, int, str, list[str], int]:
    """Return what `inspect.getframeinfo` does for one line of context, without a search through all modules."""
    code = frame.f_code
    line = linecache.getline(code.co_filename, frame.f_lineno, frame.f_globals)
    return code.co_filename, frame.f_lineno, code.co_name, [line], 0


# Taichi asks a server for its newest version; the import of what it asks with takes longer than the asking.
_version_check: Any = ModuleType("taichi._version_check")
_version_check.start_version_check_thread = lambda: None
sys.modules.setdefault(_version_check.__name__, _version_check)

# It looks for the sources of what was typed into an interpreter with dill, which takes a tenth of Taichi's import.
_dill: Any = ModuleType("dill")
_dill.__getattr__ = lambda name: getattr(importlib.import_module("dill"), name)
_kept = sys.modules.setdefault("dill", _dill)

_getframeinfo, _platform = inspect.getframeinfo, platform.platform
inspect.getframeinfo = _frame_info  # type: ignore[assignment]
platform.platform = platform.system  # all that is asked for is the system; the whole name takes a process
try:
    import taichi
    from taichi._lib import core
    from taichi.lang import expr, impl, kernel_impl, matrix_ops, ops, snode
    from taichi.lang.ast import ast_transformer_utils
    from taichi.lang.ast.ast_transformer import ASTTransformer
    from taichi.lang.exception import TaichiCompilationError, TaichiTypeError, handle_exception_from_cpp
    from taichi.lang.expr import Expr
    from taichi.lang.field import Field
finally:
    inspect.getframeinfo, platform.platform = _getframeinfo, _platform
    if _kept is _dill:
        del sys.modules["dill"]


def _inside_class(level_of_class_stackframe: int) -> bool:
    """Whether the frame so many calls up is the body of a class, by the line it is at; in place of Taichi's own."""
    try:
        frame = sys._getframe(level_of_class_stackframe)
    except ValueError:  # a function of the script itself has nothing around it
        return False
    line = _frame_info(frame)[3][0].strip()
    return any(pattern.match(line) for pattern in kernel_impl._KERNEL_CLASS_STACKFRAME_STMT_RES)


def _no_traceback(stacklevel: int = 1) -> str:
    """Return what Taichi keeps of where a field was declared: nothing. It would read the whole stack, for every field."""
    return ""


class _Lines(list[str]):
    """The lines of a function, and the words for their positions as far as somebody asked."""

    def __init__(self, lines: list[str]):
        super().__init__(lines)
        self.positions: dict[int, str] = {}


class _Source:
    """A function's source; `spare` holds its trees that are not in use."""

    def __init__(self, function: Any):
        self.file = inspect.getsourcefile(function)
        lines, self.first, root = _source_lines(function)
        self.text = textwrap.dedent("".join(lines))
        self.lines = _Lines([line.rstrip() for line in lines])
        self.spare = [_Tree(self, root)] if root else []

    def tree(self) -> _Tree:
        """Return a tree that nobody uses: a function may be inlined in itself."""
        return self.spare.pop() if self.spare else _Tree(self, ast.parse(self.text))


_NOTED = (ast.stmt, ast.expr, ast.keyword, ast.Slice, ast.comprehension)  # what Taichi leaves notes on, not operators


class _Tree:
    """A parsed function. Tracing leaves notes on the nodes and takes the arguments of a kernel away."""

    def __init__(self, source: _Source, root: ast.Module):
        self.source, self.root = source, root
        self._function: Any = self.root.body[0]
        self._function.decorator_list = []
        self._arguments = list(self._function.args.args)
        self._notes = [node.__dict__ for node in ast.walk(self.root) if isinstance(node, _NOTED)]

    def give_back(self) -> None:
        """Make the tree as it was and let others use it."""
        for notes in self._notes:
            notes.pop("ptr", None)
            notes.pop("caller", None)
        self._function.args.args = list(self._arguments)
        self.source.spare.append(self)


def _source_lines(function: Any) -> tuple[list[str], int, ast.Module | None]:
    """Return what `inspect.getsourcelines` does, the lines of a function and the number of the first, without its tokeniser.

    The third is what they parse to, if it took that to find them.

    A function ends before the first line that is indented no deeper than it is and with which what came before parses: within
    brackets or strings it would not.
    """
    code = function.__code__
    lines, first = linecache.getlines(code.co_filename, function.__globals__), code.co_firstlineno
    margin = _indentation(lines[first - 1]) if len(lines) >= first else 0
    begun = False
    for end in range(first, len(lines)):
        begun = begun or lines[end - 1].lstrip().startswith("def ")
        line = lines[end].strip()
        if begun and line and not line.startswith("#") and _indentation(lines[end]) <= margin:
            found = lines[first - 1 : end]
            try:
                return found, first, ast.parse(textwrap.dedent("".join(found)))
            except SyntaxError:
                continue
    return *kernel_impl.getsourcelines(function), None


def _indentation(line: str) -> int:
    return len(line) - len(line.lstrip())


_source = functools.cache(_Source)


def _tree_and_context(
    function: Any,
    excluded_parameters: Any = (),
    is_kernel: bool = True,
    arg_features: Any = None,
    args: Any = None,
    ast_builder: Any = None,
    is_real_function: bool = False,
) -> tuple[_Tree, Any]:
    """Return a function's tree and the context to transform it in; in place of `kernel_impl._get_tree_and_ctx`."""
    source = _source(function.func)
    names = kernel_impl._get_global_vars(function.func)
    if is_kernel or is_real_function:
        for i in function.template_slot_locations:
            names[function.arguments[i].name] = args[i]
    context = ast_transformer_utils.ASTTransformerContext(
        excluded_parameters=excluded_parameters,
        is_kernel=is_kernel,
        func=function,
        arg_features=arg_features,
        global_vars=names,
        argument_data=args,
        src=source.lines,
        start_lineno=source.first,
        file=source.file,
        ast_builder=ast_builder,
        is_real_function=is_real_function,
    )
    return source.tree(), context


_transformer = ASTTransformer()


def _transform(tree: _Tree, context: Any) -> Any:
    """Trace a tree; in place of `transform_tree`."""
    try:
        _transformer(context, tree.root)
    finally:
        tree.give_back()
    return context.return_data


def _position(context: Any, node: Any) -> str:
    """Return where a node stands: file, line, function and the line itself; in place of `get_pos_info`."""
    words = context.src.positions.get(node.lineno)
    if words is None:
        line = node.lineno + context.lineno_offset
        words = (
            f'File "{context.file}", line {line}, in {context.func.func.__name__}:\n{context.src[node.lineno - 1]}\n'
        )
        context.src.positions[node.lineno] = words
    return words


@functools.cache
def _builder(kind: type[ast.AST]) -> tuple[Any, bool]:
    """Return the method of the transformer that builds nodes of this kind, and whether they are statements."""
    return getattr(ASTTransformer, f"build_{kind.__name__}", None), issubclass(kind, ast.stmt)


def _build(self: Any, context: Any, node: ast.AST) -> Any:
    """Trace one node; in place of `Builder.__call__`. Of the positions that Taichi keeps at hand those of statements are enough."""
    method, is_statement = _builder(node.__class__)
    try:
        if method is None:
            raise ast_transformer_utils.TaichiSyntaxError(f'Unsupported node "{node.__class__.__name__}"')
        if not is_statement:
            return method(context, node)
        with impl.get_runtime().src_info_guard(_position(context, node)):
            return method(context, node)
    except Exception as error:
        if getattr(impl.get_runtime(), "print_full_traceback", False):  # set by ti.init
            raise
        if context.raised or not isinstance(node, ast.stmt | ast.expr):
            raise error.with_traceback(None)  # noqa: B904  # it is itself on its way out
        context.raised = True
        known = handle_exception_from_cpp(error)
        if isinstance(known, TaichiCompilationError):
            raise type(known)(_position(context, node) + str(known)) from None
        raise TaichiCompilationError(_position(context, node) + traceback.format_exc()) from None


_OPERATORS: dict[type[ast.operator], Any] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.FloorDiv: operator.floordiv,
    ast.Mod: operator.mod,
    ast.Pow: operator.pow,
    ast.LShift: operator.lshift,
    ast.RShift: operator.rshift,
    ast.BitOr: operator.or_,
    ast.BitXor: operator.xor,
    ast.BitAnd: operator.and_,
    ast.MatMult: matrix_ops.matmul,
}


def _build_operation(context: Any, node: Any) -> Any:
    """Trace a binary operation; in place of `ASTTransformer.build_BinOp`, which makes a table of them for each."""
    _transformer(context, node.left)
    _transformer(context, node.right)
    try:
        node.ptr = _OPERATORS[node.op.__class__](node.left.ptr, node.right.ptr)
    except TypeError as error:
        raise TaichiTypeError(str(error)) from None
    return node.ptr


def _build_name(context: Any, node: Any) -> Any:
    """Look a name up; in place of `ASTTransformer.build_Name`. What it stands for keeps the position of where it was made."""
    node.ptr = context.get_var_by_name(node.id)
    return node.ptr


_get_decorator = ASTTransformer.get_decorator


def _decorator(context: Any, node: Any) -> str:
    """Return whether a call is one of `static` and the like; in place of `get_decorator`, once for each node."""
    found = node.__dict__.get("decorator")
    if found is None:
        found = node.decorator = _get_decorator(context, node)
    return found


_expr = Expr.__init__
_constant = expr.make_constant_expr
_initial = impl.expr_init
_binary = ops._binary_operation


def _expression(self: Any, *arguments: Any, dbg_info: Any = None, dtype: Any = None) -> None:
    """Wrap an expression, nearly always one of Taichi's core; in place of `Expr.__init__`."""
    if len(arguments) != 1 or arguments[0].__class__ is not core.Expr:
        _expr(self, *arguments, dbg_info=dbg_info, dtype=dtype)
        return
    self.ptr, self.dbg_info = arguments[0], dbg_info
    if dbg_info is not None:
        self.ptr.set_dbg_info(dbg_info)
    runtime: Any = impl.pytaichi
    self.ptr.type_check(runtime.prog.config())
    self.ptr_type_checked = True


def _constant_expression(value: Any, dtype: Any) -> Any:
    """Return a literal; in place of `make_constant_expr`, which asks NumPy for the range of the type, twice."""
    if dtype is None:
        kind = value.__class__
        if kind is float:
            return Expr(core.make_const_expr_fp(impl.pytaichi.default_fp, value))
        if kind is int and -(2**31) <= value < 2**31:  # the default type of integers has 32 or 64 bits
            return Expr(core.make_const_expr_int(impl.pytaichi.default_ip, value))
    return _constant(value, dtype)


def _initial_value(value: Any) -> Any:
    """Return a new variable; in place of `expr_init`, which first asks for a dozen rarer kinds of value."""
    if value.__class__ is not Expr:
        return _initial(value)
    runtime: Any = impl.pytaichi
    info = core.DebugInfo(runtime.get_current_src_info())
    return Expr(runtime.compiling_callable.ast_builder().expr_var(value.ptr, info))


def _binary_operation(taichi_op: Any, python_op: Any, a: Any, b: Any) -> Any:
    """Return `a op b`; in place of Taichi's own, which asks for fields before expressions."""
    if a.__class__ is not Expr or (b.__class__ is not Expr and isinstance(b, Field)):
        return _binary(taichi_op, python_op, a, b)
    info = core.DebugInfo(impl.pytaichi.get_current_src_info())
    if b.__class__ is not Expr:
        b = Expr(b, dbg_info=info)
    return Expr(taichi_op(a.ptr, b.ptr), dbg_info=info)


_OURS: tuple[tuple[Any, str, Any], ...] = (
    (kernel_impl, "_inside_class", _inside_class),
    (impl, "get_traceback", _no_traceback),
    (snode, "get_traceback", _no_traceback),
    (kernel_impl, "_get_tree_and_ctx", _tree_and_context),
    (kernel_impl, "transform_tree", _transform),
    (ast_transformer_utils.Builder, "__call__", _build),
    (ast_transformer_utils.ASTTransformerContext, "get_pos_info", _position),
    (ASTTransformer, "build_BinOp", staticmethod(_build_operation)),
    (ASTTransformer, "build_Name", staticmethod(_build_name)),
    (ASTTransformer, "get_decorator", staticmethod(_decorator)),
    (Expr, "__init__", _expression),
    (expr, "make_constant_expr", _constant_expression),
    (impl, "expr_init", _initial_value),
    (ops, "_binary_operation", _binary_operation),
)
_TAICHIS = tuple((owner, name, vars(owner)[name]) for owner, name, _ in _OURS)


def replace(functions: tuple[tuple[Any, str, Any], ...]) -> None:
    """Put functions into the modules and classes of Taichi: ours, or its own again."""
    for owner, name, function in functions:
        setattr(owner, name, function)


if taichi.__version__ == _VERSION:
    replace(_OURS)
