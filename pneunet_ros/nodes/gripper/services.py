"""Services of a gripper that call the services of all its arms."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from std_srvs.srv import Trigger


def ask_all(services: Mapping[Any, Callable[..., Any]], request: Any, response: Any) -> Any:
    """Call a service of several nodes; it succeeds if all of them do."""
    response.success, messages = True, []
    for node, serve in services.items():
        reply = serve(request, Trigger.Response())
        response.success = response.success and reply.success
        messages.append(f'{node.get_fully_qualified_name()}: {reply.message}')
    response.message = '; '.join(messages)
    return response
