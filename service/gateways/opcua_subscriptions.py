"""What OPC UA clients that subscribe are told, with the filter that they asked for (OPC UA Part 4, 7.22.2).

Asyncua 2.1 compares a value with the one written before it, and a status only where the value has left the deadband:
whatever changes slowly is never told, nor is that the service has gone. Here both are compared with what the client was
told last, as the standard has it, so that what it shows is never further from the truth than its deadband. A filter
that cannot be kept is refused.
"""

import math

from asyncua import Server, ua
from asyncua.common.callback import CallbackType, ServerItemCallback
from asyncua.server.monitored_item_service import MonitoredItemService, MonitoredItemValues
from asyncua.server.subscription_service import SubscriptionService
from asyncua.ua.uaprotocol_auto import DataChangeFilter  # what is decoded is one; ua.DataChangeFilter is a subclass

#: Data types that a deadband may be of: from SByte to Double.
_NUMBERS = frozenset(ua.NodeId(number) for number in range(ua.ObjectIds.SByte, ua.ObjectIds.Double + 1))


def tell_what_holds(server: Server) -> None:
    """Let the subscriptions of a server that is not set up yet be told as this module says."""
    internal = server.iserver
    internal.subscription_service = subscriptions = _Subscriptions(internal.aspace, internal)
    internal.isession.subscription_service = subscriptions
    server.subscribe_server_callback(CallbackType.ItemSubscriptionModified, subscriptions.tell_modified)


class _Items(MonitoredItemService):  # type: ignore[misc]  # the library's types are not read
    """The monitored items of a subscription."""

    async def tell(self, number: int) -> None:
        """Tell an item what its client does not know, by the filter that it has now."""
        item = self._monitored_items.get(number)
        if item is not None and item.callback_handle is not None and item.mode != ua.MonitoringMode.Disabled:
            source = item.read_value_id
            await self.trigger_datachange(item.callback_handle, source.NodeId, source.AttributeId)

    def _is_deadband_exceeded(self, values: MonitoredItemValues, wanted: DataChangeFilter) -> bool:
        """Return whether to tell what differs, and keep what was told last for the next comparison."""
        last, new = values.old_dvalue, values.current_dvalue
        if wanted.DeadbandType == ua.DeadbandType.None_ or last is None or last.StatusCode != new.StatusCode:
            return True
        if last.Value != new.Value and not abs(new.Value.Value - last.Value.Value) <= wanted.DeadbandValue:
            return True
        values.current_dvalue = last
        return False

    async def _create_data_change_monitored_item(
        self, params: ua.MonitoredItemCreateRequest
    ) -> ua.MonitoredItemCreateResult:
        refusal = self._refusal(params.ItemToMonitor, params.RequestedParameters.Filter)
        if refusal is not None:
            return ua.MonitoredItemCreateResult(StatusCode=ua.StatusCode(refusal))
        return await super()._create_data_change_monitored_item(params)

    def _modify_monitored_item(self, params: ua.MonitoredItemModifyRequest) -> ua.MonitoredItemModifyResult:
        item, wanted = self._monitored_items.get(params.MonitoredItemId), params.RequestedParameters.Filter
        if item is None:
            return ua.MonitoredItemModifyResult(StatusCode=ua.StatusCode(ua.StatusCodes.BadMonitoredItemIdInvalid))
        if item.callback_handle is not None:  # not one of events
            refusal = self._refusal(item.read_value_id, wanted)
            if refusal is not None:
                return ua.MonitoredItemModifyResult(StatusCode=ua.StatusCode(refusal))
        return super()._modify_monitored_item(params)

    def _refusal(self, item: ua.ReadValueId, wanted: object) -> int | None:
        """Return the status code for a filter that cannot be kept, such as a percentage: no node states a range."""
        codes, kinds = ua.StatusCodes, ua.DeadbandType
        if not wanted:
            return None
        if item.AttributeId != ua.AttributeIds.Value:
            return int(codes.BadFilterNotAllowed)
        if not isinstance(wanted, DataChangeFilter) or wanted.DeadbandType not in (kinds.None_, kinds.Absolute):
            return int(codes.BadMonitoredItemFilterUnsupported)
        if wanted.DeadbandType == kinds.None_:
            return None
        if not 0.0 <= wanted.DeadbandValue < math.inf:
            return int(codes.BadDeadbandFilterInvalid)
        data_type = self.aspace.read_attribute_value(item.NodeId, ua.AttributeIds.DataType).Value.Value
        return None if data_type in _NUMBERS else int(codes.BadFilterNotAllowed)


class _Subscriptions(SubscriptionService):  # type: ignore[misc]
    """Subscriptions with these items."""

    async def create_subscription(self, *asked: object, **more: object) -> ua.CreateSubscriptionResult:
        """Make a subscription, before any item is asked for."""
        result = await super().create_subscription(*asked, **more)
        subscription = self.subscriptions[result.SubscriptionId]
        subscription.monitored_item_srv = _Items(subscription, self.aspace)
        return result

    async def tell_modified(self, modified: ServerItemCallback, _: object) -> None:
        """Tell items that have another filter now."""
        subscription = self.subscriptions.get(modified.request_params.SubscriptionId)
        for item in modified.request_params.ItemsToModify if subscription is not None else ():
            await subscription.monitored_item_srv.tell(item.MonitoredItemId)
